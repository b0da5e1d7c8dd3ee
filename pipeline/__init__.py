"""From a USD shot to a USD cache: reading, the frame loop, writing, judging."""
