"""The packages of `ros2/` are packages by the rules of ROS 2: package.xml of format 3, versions, what is installed."""

from __future__ import annotations

import ast
import importlib.util
import re
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest

from .interfaces import PACKAGES, ROS2

ROOT = ROS2.parent
DEPENDS = ("depend", "build_depend", "exec_depend", "buildtool_depend", "build_export_depend", "test_depend")
needs_catkin = pytest.mark.skipif(importlib.util.find_spec("catkin_pkg") is None, reason="catkin-pkg (extra dev)")


def manifest(package: str) -> ElementTree.Element:
    """A package.xml."""
    return ElementTree.parse(ROS2 / package / "package.xml").getroot()


def depends(package: str) -> set[str]:
    """What a package.xml says it needs, of any kind."""
    return {str(part.text) for kind in DEPENDS for part in manifest(package).findall(kind)}


def test_these_are_all_packages() -> None:
    assert sorted(path.parent.name for path in ROS2.glob("*/package.xml")) == sorted(PACKAGES)


@needs_catkin
@pytest.mark.parametrize("package", PACKAGES)
def test_catkin_pkg_takes_the_manifest_without_a_warning(package: str) -> None:
    from catkin_pkg.package import parse_package

    warnings: list[str] = []
    found: Any = parse_package(str(ROS2 / package / "package.xml"), warnings=warnings)
    found.validate(warnings=warnings)
    assert warnings == []
    assert (found.name, found.package_format) == (package, 3)
    (licence,) = found.licenses
    assert (str(licence), (ROS2 / package / str(licence.file)).resolve()) == ("Apache-2.0", ROOT / "LICENSE")


@pytest.mark.parametrize("package", PACKAGES)
def test_versions_are_those_of_hystmpc(package: str) -> None:
    """A released version; between two releases that of the next one."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    version = re.match(r"\d+\.\d+\.\d+", settings["tool"]["setuptools_scm"]["fallback_version"])
    assert version is not None
    assert manifest(package).findtext("version") == version.group()


@pytest.mark.parametrize("package", [name for name in PACKAGES if (ROS2 / name / "CMakeLists.txt").is_file()])
def test_cmake_finds_what_the_manifest_names(package: str) -> None:
    text = (ROS2 / package / "CMakeLists.txt").read_text(encoding="utf-8")
    assert f"project({package}" in text
    assert manifest(package).findtext("export/build_type") == "ament_cmake"
    found = set(re.findall(r"find_package\((\w+) REQUIRED\)", text))
    assert found <= depends(package)
    assert depends(package) - found <= {"rosidl_default_runtime"}  # of running only
    assert text.rstrip().endswith("ament_package()")


def test_cpp_includes_are_of_packages_that_the_manifest_names() -> None:
    own = "hystmpc_controller"
    sources = [*(ROS2 / own).rglob("*.hpp"), *(ROS2 / own).rglob("*.cpp")]
    included = {name for path in sources for name in re.findall(r'#include "(\w+)/', path.read_text(encoding="utf-8"))}
    assert included <= depends(own) | {own}


def test_python_imports_are_of_packages_that_the_manifest_names() -> None:
    modules = set()
    for path in (ROS2 / "hystmpc_ros" / "hystmpc_ros").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and node.level == 0 else []
            modules |= {name.split(".")[0] for name in names}
    foreign = modules - set(sys.stdlib_module_names)
    assert foreign <= depends("hystmpc_ros") | {"hystmpc"}
    assert depends("hystmpc_ros") - foreign == {"launch", "launch_ros"}  # of the launch file


def test_the_python_package_installs_what_ament_looks_for() -> None:
    folder, name = ROS2 / "hystmpc_ros", "hystmpc_ros"
    assert manifest(name).findtext("export/build_type") == "ament_python"
    given = setup_arguments(folder / "setup.py", name)
    assert (given["name"], given["version"]) == (name, manifest(name).findtext("version"))
    placed = dict(given["data_files"])
    assert placed["share/ament_index/resource_index/packages"] == [f"resource/{name}"]
    assert placed[f"share/{name}"] == ["package.xml"]
    assert [file for files in placed.values() for file in files if not (folder / file).is_file()] == []
    (script,) = given["entry_points"]["console_scripts"]
    module, function = re.fullmatch(r"tip_planner = ([\w.]+):(\w+)", script).groups()  # type: ignore[union-attr]
    text = (folder / Path(*module.split("."))).with_suffix(".py").read_text(encoding="utf-8")
    assert f"def {function}(" in text
    assert (folder / "setup.cfg").read_text(encoding="utf-8").count(f"$base/lib/{name}") == 2  # where ros2 run looks


def setup_arguments(path: Path, name: str) -> dict[str, Any]:
    """What a setup.py hands to `setup`, without running it."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    (call,) = (node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "setup")
    return {
        str(keyword.arg): eval(ast.unparse(keyword.value), {"__builtins__": {}, "NAME": name})
        for keyword in call.keywords
    }
