"""The robot as data: profiles, manipulator and tendons, loads, and the checks of their numbers."""
