"""The package with its engine compiled; everything else stands in pyproject.toml."""

import importlib.util
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

_CORE = Path(__file__).resolve().parent / "core"
_spec = importlib.util.spec_from_file_location("hystmpc_core_build", _CORE / "build.py")
_engine = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_engine)


class BuildWithEngine(build_py):
    """Also compiles the C files; beside them for an editable installation."""

    def run(self) -> None:
        super().run()
        _engine.build(_CORE, _CORE if self.editable_mode else Path(self.build_lib) / "hystmpc" / "core")

    def find_package_modules(self, package: str, package_dir: str) -> list[tuple[str, str, str]]:
        modules = super().find_package_modules(package, package_dir)
        return [module for module in modules if Path(module[2]).name != "setup.py"]  # it lies where the package does


class PlatformWheel(bdist_wheel):
    """A wheel of this platform for every Python: the library knows nothing of Python."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", super().get_tag()[2]


class WithLibrary(Distribution):
    """Not of Python files alone."""

    def has_ext_modules(self) -> bool:
        return True


setup(
    cmdclass={"build_py": BuildWithEngine, "bdist_wheel": PlatformWheel},
    distclass=WithLibrary,
    setup_requires=[] if _engine.compiler() else ["ziglang>=0.13"],  # pip fetches it for the build
)
