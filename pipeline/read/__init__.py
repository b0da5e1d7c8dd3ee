"""USD stage to Scene."""
