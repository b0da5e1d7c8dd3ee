"""Run time against error: benchmark cases as data, and the one runner that measures them."""
