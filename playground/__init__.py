"""A page in the browser: watch a policy, move things, and drive yourself."""
