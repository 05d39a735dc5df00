"""The laboratory with its C files compiled, as the product is; everything else stands in pyproject.toml."""

import importlib.util
import shutil
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

_HERE = Path(__file__).resolve().parent
_COPY = "core_build.py"  # an sdist has no folder above it
_BUILD = next(path for path in (_HERE / _COPY, _HERE.parent / "core" / "build.py") if path.is_file())
_spec = importlib.util.spec_from_file_location("hystmpc_core_build", _BUILD)
_engine = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_engine)


class BuildWithLibrary(build_py):
    """Also compiles the C files; beside them for an editable installation."""

    def run(self) -> None:
        super().run()
        source = _HERE / "c"
        _engine.build(source, source if self.editable_mode else Path(self.build_lib) / "hystmpc_lab" / "c")

    def find_package_modules(self, package: str, package_dir: str) -> list[tuple[str, str, str]]:
        found = super().find_package_modules(package, package_dir)
        return [module for module in found if Path(module[2]).name not in ("setup.py", _COPY)]


class SourcesWithBuild(sdist):
    """Sources that can be compiled by themselves."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        super().make_release_tree(base_dir, files)
        shutil.copy(_BUILD, Path(base_dir) / _COPY)


class PlatformWheel(bdist_wheel):
    """A wheel of this platform for every Python: the library knows nothing of Python."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", super().get_tag()[2]


class WithLibrary(Distribution):
    """Not of Python files alone."""

    def has_ext_modules(self) -> bool:
        return True


setup(
    cmdclass={"build_py": BuildWithLibrary, "sdist": SourcesWithBuild, "bdist_wheel": PlatformWheel},
    distclass=WithLibrary,
    setup_requires=[] if _engine.compiler() else ["ziglang>=0.13"],
)
