"""Data sets of pictures: readers, writers, and synthetic ones."""
