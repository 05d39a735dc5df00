"""Programs of operators as straight-line C: one statement an instruction, by the operations of `core/operations.h`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

from hystmpc.models.stages import CODES

ABREAST = """#if defined(__clang__)
#define STRAIGHT_ABREAST _Pragma("clang loop vectorize(assume_safety)")
#elif defined(__GNUC__)
#define STRAIGHT_ABREAST _Pragma("GCC ivdep") /* rows side by side do not know each other */
#else
#define STRAIGHT_ABREAST
#endif
"""
_CHAIN_HEAD, _STAGE, _HEAD, _WORDS = 8, 9, 20, 5  # numbers, see `core/chain.h` and `core/program.h`
_PHASES = ("once", "ahead", "through", "behind", "slopes", "by_parameters", "fixed", "moving", "rest")
_REPLACED = ("ahead", "through", "behind", "slopes", "by_parameters", "moving")  # no controller needs `by_parameters`
_BY_PARAMETER = 2
_NAMES = {code: name for name, code in CODES.items()}

_Code = Sequence[Sequence[int]]


def straight(chains: Mapping[str, Sequence[int]]) -> str:
    """C text of the functions of all tables in some chains, and of `hystmpc_straight_for`, which finds them.

    Args:
        chains: whole numbers of each chain, see `core/chain.h`, by the name of its array, which holds them `shortened`.
    """
    texts: list[str] = []
    known: dict[tuple[int, ...], int] = {}
    answers: list[str] = []
    for name, words in chains.items():
        for at, place in zip(_tables(words), _tables(shortened(words)), strict=True):
            table = tuple(words[at : _end(words, at)])
            if table not in known:
                known[table] = len(known)
                texts.append(_functions(f"straight_{known[table]}", table))
            answers.append(f"    if (table == {name} + {place}) return straight + {known[table]};\n")
    kinds = ("run", "slopes", "moving")
    rows = [f"    {{{', '.join(f'straight_{k}_{kind}' for kind in kinds)}}},\n" for k in known.values()]
    listed = f"static const hystmpc_straight straight[] = {{\n{''.join(rows)}}};\n\n" if rows else ""
    finder = "HYSTMPC_LOCAL const hystmpc_straight *hystmpc_straight_for(const int *table) {\n"
    return "".join([ABREAST, *texts, listed, finder, *(answers or ["    (void)table;\n"]), "    return NULL;\n}\n"])


def shortened(words: Sequence[int]) -> list[int]:
    """A chain without the instructions that functions in C replace."""
    places = range(_CHAIN_HEAD + words[6], _CHAIN_HEAD + words[6] + _STAGE * words[0], _STAGE)
    result = list(words[: _CHAIN_HEAD + words[6] + _STAGE * words[0]])
    for place in places:
        at, rest, wires = words[place], words[place + 1], words[place + 8]
        behind = words[place + _STAGE + 8] if place + _STAGE in places else len(words)
        table = words[at : _end(words, at)]
        code, end = _instructions(table)
        kept = [] if rest < 0 else words[rest:behind]
        head = [*table[: _HEAD - len(_PHASES)], *(0 if p in _REPLACED else len(code[p]) for p in _PHASES)]
        left = [number for p in _PHASES if p not in _REPLACED for one in code[p] for number in one]
        short = [*head, *table[_HEAD : _HEAD + table[5]], *left, *table[end:]]
        for number, part in ((8, words[wires:at]), (0, short), (1, kept)):
            result[place + number] = len(result) if part else -1
            result += part
    return result


def _tables(words: Sequence[int]) -> Sequence[int]:
    """Where the tables of a chain's steps begin."""
    first = _CHAIN_HEAD + words[6]
    return words[first : first + _STAGE * words[0] : _STAGE]


def _end(words: Sequence[int], at: int) -> int:
    """Behind the last number of a table."""
    states, _, _, outputs, kept, _, slopes, groups = words[at + 1 : at + 9]
    end = at + _HEAD + kept + _WORDS * sum(words[at + _HEAD - len(_PHASES) : at + _HEAD]) + 3 * slopes
    end += states + outputs + 1
    for _ in range(groups):
        end += 1 + words[end]
    return end + 1 + outputs + states


def _instructions(table: Sequence[int]) -> tuple[dict[str, _Code], int]:
    """Instructions of a table by phase, and where they end."""
    code, at = dict[str, _Code](), _HEAD + table[5]
    for phase, length in zip(_PHASES, table[_HEAD - len(_PHASES) : _HEAD], strict=True):
        code[phase] = [table[k : k + _WORDS] for k in range(at, at + _WORDS * length, _WORDS)]
        at += _WORDS * length
    return code, at


def _functions(name: str, table: Sequence[int]) -> str:
    """The functions of one table."""
    states, inputs, _, outputs, kept, _, slopes = table[1:8]
    code, at = _instructions(table)
    terms = [table[k : k + 3] for k in range(at, at + 3 * slopes, 3)]
    following = range(kept + states, kept + 2 * states)
    shown = range(kept + 2 * states + inputs, kept + 2 * states + inputs + outputs)
    step = [*code["ahead"], *code["through"], *code["behind"]]
    derived = [row for by, _, row in terms if by != _BY_PARAMETER]
    read_later = {*table[-1 - outputs - states :], *(k for one in code["rest"] for k in one[2:])}
    run = _statements(step, [*following, *shown], lambda row: f"row[{row}][l{' - t' * (row < kept)}]")
    by_signals = _statements([*step, *code["slopes"]], [*following, *shown, *derived], lambda row: f"row[{row}][t]")
    moving = _statements(code["moving"], read_later, lambda register: f"registers[{register}]")
    return (
        f"static void {name}_run(real *const *row, int abreast, int samples) {{\n"
        "    for (int t = 0; t < samples * abreast; t += abreast)\n"
        "        STRAIGHT_ABREAST\n"
        f"        for (int l = t; l < t + abreast; l++) {{\n{_indented(run, 12)}        }}\n}}\n\n"
        f"static void {name}_slopes(real *const *row, int samples) {{\n"
        f"    for (int t = 0; t < samples; t++) {{\n{_indented(by_signals, 8)}    }}\n}}\n\n"
        f"static void {name}_moving(real *registers) {{\n{_indented(moving or ['(void)registers;'], 4)}}}\n\n"
    )


def _statements(code: _Code, wanted: Collection[int], place: Callable[[int], str]) -> list[str]:
    """Statements of some instructions, with local variables; `wanted` are numbers that are stored at their place."""
    lines: list[str] = []
    names: dict[int, str] = {}
    for k, (operation, to, *arguments) in _live(code, wanted):
        for number in arguments:
            if number not in names:
                names[number] = f"r{number}"
                lines.append(f"const real r{number} = {place(number)};")
        read = ", ".join(names[number] for number in arguments)
        names[to] = f"v{k}"
        lines.append(f"const real v{k} = hystmpc_op_{_NAMES[operation]}({read});")
    stored = [number for number in sorted(set(wanted)) if names.get(number, "r")[0] == "v"]
    return [*lines, *(f"{place(number)} = {names[number]};" for number in stored)]


def _live(code: _Code, wanted: Collection[int]) -> list[tuple[int, Sequence[int]]]:
    """Instructions that what is wanted needs, with their places."""
    needed, live = set(wanted), list[tuple[int, Sequence[int]]]()
    for k in range(len(code) - 1, -1, -1):
        if code[k][1] in needed:
            live.append((k, code[k]))
            needed -= {code[k][1]}
            needed |= set(code[k][2:])
    return live[::-1]


def _indented(lines: Sequence[str], columns: int) -> str:
    return "".join(f"{' ' * columns}{line}\n" for line in lines)
