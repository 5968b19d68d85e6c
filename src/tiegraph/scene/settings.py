"""Settings of the scan stage."""
