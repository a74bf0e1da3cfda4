"""Run the notebooks beside this file anew, and keep their outputs: `python
docs/notebooks/execute.py [NAME...]`."""

import re
import shutil
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).parent
NOTEBOOKS = tuple(sorted(path.stem for path in HERE.glob("*.ipynb")))
MOST_SECONDS = 900  # of a cell
OPEN3D = "Enabling Open3D WebVisualizer"  # which it says of every notebook that imports it
# with its place and its line of code
WARNING = re.compile(r"^\S+\.py:\d+: (\w*Warning: .*\n) .*\n", re.MULTILINE)


def execute(name: str) -> nbformat.NotebookNode:
    """Run a notebook in an empty folder beside the documentation's map and poles. Raises at the
    first error."""
    notebook = nbformat.read(HERE / f"{name}.ipynb", as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        for given in HERE.parent.glob("own-junction*"):
            if given.suffix != ".md":
                shutil.copy(given, folder)
        place = Path(folder) / "notebooks"
        place.mkdir()
        resources = {"metadata": {"path": str(place)}}
        client = NotebookClient(
            notebook, timeout=MOST_SECONDS, record_timing=False, resources=resources
        )
        client.coalesce_streams = True
        client.execute()
    for cell in notebook.cells:
        outputs = [each for each in cell.get("outputs", []) if OPEN3D not in each.get("text", "")]
        for each in outputs:
            if "text" in each:
                each.text = WARNING.sub(r"\1", each.text)
        if "outputs" in cell:
            cell.outputs = outputs
    return notebook


def main() -> None:
    """Run some notebooks, all by default."""
    for name in sys.argv[1:] or NOTEBOOKS:
        nbformat.write(execute(name), HERE / f"{name}.ipynb")


if __name__ == "__main__":
    main()
