"""What makes the published numbers: a list of runs and its runner, tables, figures, benchmark."""
