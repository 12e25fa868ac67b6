"""Looking at takes: what one holds, and how two differ."""
