"""Reports, one output format a file."""
