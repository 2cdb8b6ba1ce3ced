"""Checks of what a caller gives: one line says what was given, where, and what is allowed."""
