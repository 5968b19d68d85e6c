"""The example survey of tiegraph. `tiegraph demo` reads it; it holds files only."""
