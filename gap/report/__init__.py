"""The report of a diagnosis: what it shows (`evidence`), the page, its figures, and the folder that it leaves."""
