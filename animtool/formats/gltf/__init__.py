"""glTF: reader and writer of .gltf, .glb and .vrm files.

Uses only JSON and `numpy.frombuffer`: every length, stride, index and loop is checked
before memory is allocated, and no file outside the folder is opened.
"""
