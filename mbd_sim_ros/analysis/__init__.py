"""What is done with recordings: tables, comparison, plots."""
