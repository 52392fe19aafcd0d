"""The blind study of the diagnosis: what is drawn (`cases`), how a verdict is judged (`judge`), what is told (`table`)."""
