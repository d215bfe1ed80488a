"""Camera pairs behind one port."""
