"""Characters in files of nodes and skins, common to glTF and FBX."""
