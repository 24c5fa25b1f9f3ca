"""What the lesson uses and does not teach: command line, run folders, processes, pictures."""
