"""Parts that the lesson uses but does not teach: command line, run folders, processes, pictures."""
