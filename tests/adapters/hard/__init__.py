"""The cases that simulations break on, of each thing that simulates."""
