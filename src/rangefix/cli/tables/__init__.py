"""Every table on the terminal, and the lines that are told with it."""
