"""Effects an elastic arm may have beyond its declared model: one file each, one list of them (`ident.effects.catalogue`)."""
