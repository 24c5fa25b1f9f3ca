"""Small files, each with a gap to fill until its tests pass (docs/class.md)."""
