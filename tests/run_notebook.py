"""Runs every cell of a notebook: run_notebook.py NOTEBOOK. What a cell raises ends it."""

import sys
from pathlib import Path

import nbclient
import nbformat

path = Path(sys.argv[1])
notebook = nbformat.read(path, as_version=4)
nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(path.parent)}}).execute()
cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
figures = sum("image/png" in output.get("data", {}) for cell in cells for output in cell.outputs)
assert figures == 2, f"{figures} figures"
print(len(cells), figures)
