"""Teaching material that accompanies the lesson (docs/class.md)."""
