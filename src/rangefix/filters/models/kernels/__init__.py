"""What models compile: loops that are loaded when many states are asked about."""
