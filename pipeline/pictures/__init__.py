"""What `plait preview` draws with: what a stage shows, its colours, cameras, and the canvas."""
