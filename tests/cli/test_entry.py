"""The program's start: Ctrl-C ends it without a trace, also while it is still importing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from importlib.metadata import version

import pytest
import typer

from hystmpc.cli.main import VERBS, app
from hystmpc.cli.verb import entries_of
from hystmpc.models.kinds.catalogue import kind_names
from hystmpc.tasks.fit import fit
from hystmpc.trials.layouts import LAYOUTS


@pytest.mark.slow
@pytest.mark.parametrize("after_s", [0.2, 0.5])
def test_ctrl_c_during_the_start_is_quiet(after_s: float) -> None:
    code = "import sys; from hystmpc.cli.entry import main; print('on', flush=True); sys.argv[1:] = ['effects']; main()"
    program = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert program.stdout is not None
    assert program.stdout.readline() == "on\n"
    time.sleep(after_s)
    program.send_signal(signal.SIGINT)
    _, said = program.communicate(timeout=60)
    assert program.returncode in (0, 130)  # 0 where it was done by then
    assert "Traceback" not in said


HIDES_CTRL_C = """
import sys, time
from hystmpc.cli.entry import main
class Extension:
    def find_spec(self, name, *_):
        if name == "hystmpc.cli.reference":
            print("on", flush=True)
            try:
                time.sleep(60)
            except KeyboardInterrupt:
                raise ImportError("the extension failed to import") from None
sys.meta_path.insert(0, Extension())
sys.argv[1:] = ["effects"]
main()
"""


def test_ctrl_c_is_no_error_of_a_module_that_was_being_imported() -> None:
    program = subprocess.Popen([sys.executable, "-c", HIDES_CTRL_C], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert program.stdout is not None
    assert program.stdout.readline() == b"on\n"
    program.send_signal(signal.SIGINT)
    _, said = program.communicate(timeout=60)
    assert (program.returncode, said) == (130, b"")


HEAVY = ("casadi", "matplotlib", "scipy", "pydantic", "onnx", "onnxruntime", "torch")


def test_help_lists_every_verb_and_imports_none() -> None:
    code = (
        "import sys\nfrom hystmpc.cli.main import main\nsys.argv = ['hystmpc', '--help']\n"
        "try:\n    main()\nfinally:\n    print('loaded:', *sorted(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    text, _, loaded = done.stdout.partition("loaded:")
    assert [verb for verb in VERBS if f"  {verb} " not in text] == []
    assert [name for name in loaded.split() if name in HEAVY or name.startswith("hystmpc.models")] == []


def test_a_verb_that_is_not_known_is_answered_with_the_nearest() -> None:
    code = "import sys; from hystmpc.cli.main import main; sys.argv = ['hystmpc', 'simulat']; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "No such command 'simulat'. Did you mean 'simulate'?" in done.stderr


EXPLAINED = """
import sys
from hystmpc.cli.main import VERBS, main
for verb in VERBS:
    sys.argv = ["hystmpc", verb, "--help"]
    try:
        main()
    except SystemExit as end:
        if end.code:
            sys.exit(f"{verb} failed")
"""


@pytest.mark.slow
def test_every_verb_explains_itself() -> None:
    done = subprocess.run([sys.executable, "-c", EXPLAINED], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert [verb for verb in VERBS if f"Usage: hystmpc {verb} " not in done.stdout] == []


def program(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    code = "import sys; from hystmpc.cli.entry import main; sys.argv[0] = 'hystmpc'; main()"
    settings = {**os.environ, **environment}
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, env=settings)


def test_the_version_is_that_of_the_package() -> None:
    assert program("--version").stdout == f"hystmpc {version('hystmpc')}\n"


@pytest.mark.slow
@pytest.mark.parametrize("verb", [(), ("effects",)])
def test_h_is_help(verb: tuple[str, ...]) -> None:
    short, long = program(*verb, "-h"), program(*verb, "--help")
    assert (short.returncode, short.stdout) == (0, long.stdout)
    assert "-h, --help" in short.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("typed", "word", "offered"),
    [("hystmpc si", "1", {"simulate"}), ("hystmpc export --f", "2", {"--force"}), ("hystmpc --ve", "1", {"--version"})],
)
def test_a_shell_completes_verbs_and_options(typed: str, word: str, offered: set[str]) -> None:
    shell = {"_HYSTMPC_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": word}
    assert set(program(**shell).stdout.split()) == offered


def test_every_verb_can_be_made_and_explains_each_option() -> None:
    program = typer.main.get_command(app)
    context = program.make_context("hystmpc", [], resilient_parsing=True)
    for verb in VERBS:
        command = program.get_command(context, verb)  # type: ignore[attr-defined]  # it is a group
        assert [option.name for option in command.params if not getattr(option, "help", "")] == []


def test_the_help_names_every_kind_of_model_and_every_layout() -> None:
    meanings = entries_of(fit.__doc__, "Args")
    assert [name for name in kind_names() if name not in meanings["kind"]] == []
    assert [layout.name for layout in LAYOUTS if layout.name not in meanings["layout"]] == []
