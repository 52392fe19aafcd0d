"""One flexible joint: two masses fitted to its frequency response, a drive from several records, inertias solved for alpha."""
