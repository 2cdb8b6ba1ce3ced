"""What a caller gives, checked: one line that says what was given, where, and what is allowed."""
