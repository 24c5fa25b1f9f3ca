"""For a class: what a teacher needs beside the lesson (docs/class.md)."""
