"""Small files with a hole each: fill it until its tests pass (docs/class.md)."""
