"""Parts that every page shares: style sheet, tables, embedded figures, plot style."""
