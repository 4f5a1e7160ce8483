"""The numbers in every report: verdicts, estimates with intervals, and the comparison of methods."""
