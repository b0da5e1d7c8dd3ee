"""What ships as data: the sample shot, its generator, the scene for CI and its reference cache."""
