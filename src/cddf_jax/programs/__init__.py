"""Compiled programs that are kept in the user's cache folder, so that the next process neither traces nor compiles."""
