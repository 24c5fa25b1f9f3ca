"""Solutions of the exercises. Look here last."""
