"""Report of a diagnosis: its data, tables, figures, page and folder."""
