"""What an identification found, for people and programs: figures, pages, result.json."""
