"""Interactive HTML pages, and plots drawn by matplotlib."""
