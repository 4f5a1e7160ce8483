"""The Python functions: one for each verb of the command line."""
