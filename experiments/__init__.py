"""The published numbers: a list of runs and its runner, tables, figures, diagrams, benchmark."""
