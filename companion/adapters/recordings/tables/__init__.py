"""Laboratory tables: CSV folders, and foreign tables read through a mapping."""
