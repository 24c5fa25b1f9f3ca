"""A page in the browser: watch a policy drive, move things, and drive yourself."""
