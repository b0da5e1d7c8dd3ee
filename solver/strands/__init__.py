"""Hair and ropes: implicit discrete elastic rods, one direct solve a strand."""
