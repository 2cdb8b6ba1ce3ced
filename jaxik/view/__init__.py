"""Pictures, and a page to look at."""
