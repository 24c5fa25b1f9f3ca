"""What fills the holes of the exercises. Look here last."""
