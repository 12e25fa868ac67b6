"""USD layers, read and written: the only package that imports pxr."""
