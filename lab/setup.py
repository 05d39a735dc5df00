"""The laboratory with its C files compiled, as the product is; everything else stands in pyproject.toml."""

import runpy
import shutil
from pathlib import Path

from setuptools.command.sdist import sdist

_HERE = Path(__file__).resolve().parent
_COPY = "core_build.py"  # an sdist has no folder above it
_BUILD = next(path for path in (_HERE / _COPY, _HERE.parent / "core" / "build.py") if path.is_file())


class SourcesWithBuild(sdist):
    """Sources that can be compiled by themselves."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        super().make_release_tree(base_dir, files)
        shutil.copy(_BUILD, Path(base_dir) / _COPY)


runpy.run_path(str(_BUILD))["set_up"]("hystmpc_lab", _HERE / "c", ("setup.py", _COPY), sdist=SourcesWithBuild)
