"""Simulations that the worlds of stemworlds are put together from; stemworlds finds them by itself."""
