"""glTF: reader and writer of .gltf, .glb and .vrm files.

JSON and `numpy.frombuffer` are all it takes: every length, stride, index and loop is
checked before memory is taken, and no file outside of the folder is opened.
"""
