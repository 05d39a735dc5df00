"""One trial written as many programs write logs: what is read has to be the same whoever wrote it."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vec = NDArray[np.float64]
Writer = Callable[[Path, Vec, Vec, Vec], Path]
"""Writes time [s], command [mm] and angle [deg] into a folder; the numbers have at most three decimals."""

START = datetime(2022, 10, 24, 23, 59, 58)
HEADER = ("time_s", "command_mm", "angle_deg")


def _write(folder: Path, text: str, encoding: str = "utf-8", name: str = "log.csv") -> Path:
    (folder / name).write_bytes(text.encode(encoding))
    return folder / name


def _rows(t: Vec, u: Vec, y: Vec, form: Callable[[float], str] = repr) -> list[list[str]]:
    return [[form(value) for value in row] for row in zip(t.tolist(), u.tolist(), y.tolist(), strict=True)]


def _text(rows: list[list[str]], sign: str = ",", header: tuple[str, ...] = HEADER, end: str = "\n") -> str:
    return end.join(sign.join(row) for row in [list(header), *rows]) + end


def _comma(value: float) -> str:
    return f"{value:.3f}".replace(".", ",")


def _thousands(value: float) -> str:
    return f'"{value:,.3f}"'


def _german(value: float) -> str:
    return f"{value:,.3f}".translate(str.maketrans(",.", ".,"))


def delimited(sign: str) -> Writer:
    return lambda folder, t, u, y: _write(folder, _text(_rows(t, u, y), sign))


def encoded(encoding: str, mark: str = "") -> Writer:
    return lambda folder, t, u, y: _write(folder, mark + _text(_rows(t, u, y)), encoding)


def formed(form: Callable[[float], str], sign: str) -> Writer:
    return lambda folder, t, u, y: _write(folder, _text(_rows(t, u, y, form), sign))


def above(preamble: str, sign: str = ",") -> Writer:
    return lambda folder, t, u, y: _write(folder, preamble + _text(_rows(t, u, y), sign))


def below(row: str) -> Writer:
    def write(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
        head, _, rest = _text(_rows(t, u, y)).partition("\n")
        return _write(folder, f"{head}\n{row}\n{rest}")

    return write


def dated(form: str, name: str = "time_s", sign: str = ",", digits: int = 3) -> Writer:
    """Time as a date and time of day; `%f` has so many digits."""

    def write(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
        stamps = [START + timedelta(milliseconds=round(1e3 * s)) for s in t.tolist()]
        short = [form.replace("%f", f"{stamp.microsecond:06d}"[:digits]) for stamp in stamps]
        rows = _rows(t, u, y)
        texts = [[stamp.strftime(text), *row[1:]] for stamp, text, row in zip(stamps, short, rows, strict=True)]
        return _write(folder, _text(texts, sign, (name, *HEADER[1:])))

    return write


def with_footer(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
    return _write(folder, _text(_rows(t, u, y)) + "\n# end of the log\nstopped by the user\n")


def with_text_channels(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
    rows = [["run" if k else "", *row, "ok", "" if k else "7"] for k, row in enumerate(_rows(t, u, y))]
    return _write(folder, _text(rows, header=("state", *HEADER, "note", "error")))


def events(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
    """A row for the command and a row for the angle, as loggers of several rates write."""
    rows = [row for s, a, b in _rows(t, u, y) for row in ([s, a, ""], [s, "", b])]
    return _write(folder, _text(rows))


def sheet(folder: Path, t: Vec, u: Vec, y: Vec, stamps: list[Any] | None = None) -> Path:
    from openpyxl import Workbook

    book = Workbook()
    book.active.title = "about"
    book.active.append(["bench", "A"])
    page = book.create_sheet("data")
    page.append(["recorded by", "J. Smith"])
    page.append([])
    page.append(["time" if stamps else "time_s", *HEADER[1:]])
    for s, a, b in zip(stamps or t.tolist(), u.tolist(), y.tolist(), strict=True):
        page.append([s, a, b])
    book.save(folder / "log.xlsx")
    return folder / "log.xlsx"


def sheet_of_dates(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
    return sheet(folder, t, u, y, [START + timedelta(milliseconds=round(1e3 * s)) for s in t.tolist()])


def workbook_named_csv(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
    return sheet(folder, t, u, y).rename(folder / "log.csv")


def lvm(x: str, decimal: str = ".", sign: str = "\t", names: tuple[str, ...] = HEADER[1:]) -> Writer:
    """As LabVIEW writes measurements, with one time column or none."""

    def write(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
        step = repr(round(float(t[1] - t[0]), 6)).replace(".", decimal)
        kind = {"\t": "Tab", ",": "Comma"}[sign]
        head = [["LabVIEW Measurement", ""], ["Writer_Version", "2"], ["Separator", kind]]
        head += [["Decimal_Separator", decimal], ["Multi_Headings", "No"], ["X_Columns", x], ["Date", "2022/10/24"]]
        head += [["***End_of_Header***", ""], [""], ["Channels", "2"], ["Samples", str(t.size), str(t.size)]]
        head += [["Y_Unit_Label", "mm", "deg"], ["X_Dimension", "Time", "Time"], ["X0", f"0{decimal}0E+0"] * 1]
        head += [["Delta_X", step, step], ["***End_of_Header***"], ["X_Value", *names, "Comment"]]
        rows = [[row[0] if x == "One" else "", *row[1:]] for row in _rows(t, u, y)]
        body = [[cell.replace(".", decimal) for cell in row] for row in rows]
        return _write(folder, "\r\n".join(sign.join(row) for row in [*head, *body]) + "\r\n", name="log.lvm")

    return write


def numpy_named(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
    np.savez_compressed(folder / "log.npz", time_s=t, command=u, angle_deg=y)
    return folder / "log.npz"


def numpy_records(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
    np.save(folder / "log.npy", np.rec.fromarrays([t, u, y], names=",".join(HEADER)))
    return folder / "log.npy"


def matlab(**variables: Callable[[Vec, Vec, Vec], Any]) -> Writer:
    def write(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
        from scipy.io import savemat

        savemat(folder / "log.mat", {name: make(t, u, y) for name, make in variables.items()})
        return folder / "log.mat"

    return write


def tdms(waveforms: bool) -> Writer:
    def write(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
        from nptdms import ChannelObject, TdmsWriter

        about = {"wf_start_offset": 0.0, "wf_increment": float(t[1] - t[0])} if waveforms else {}
        channels = {"command_mm": u, "angle_deg": y} | ({} if waveforms else {"time_s": t})
        with TdmsWriter(folder / "log.tdms") as file:
            file.write_segment([ChannelObject("bench 1.2", name, values, about) for name, values in channels.items()])
        return folder / "log.tdms"

    return write


def tdms_of_dates(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    stamps = np.datetime64(START) + np.rint(1e6 * t).astype("timedelta64[us]")
    with TdmsWriter(folder / "log.tdms") as file:
        channels = {"Time": stamps, "command_mm": u, "angle_deg": y}
        file.write_segment([ChannelObject("data", name, values) for name, values in channels.items()])
    return folder / "log.tdms"


def mcap(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
    from hystmpc.trials.mcap_ import format_mcap

    (folder / "log.mcap").write_bytes(format_mcap({"time_s": t, "command": u, "angle_deg": y}, t, 10**18))
    return folder / "log.mcap"


def ros1(folder: Path, t: Vec, u: Vec, y: Vec) -> Path:
    from rosbags.rosbag1 import Writer as BagWriter
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "bench/msg/Sample"
    store.register(get_types_from_msg("float64 time_s\nfloat64 command_mm\nfloat64 angle_deg\n", kind))
    with BagWriter(folder / "log.bag") as bag:
        topic = bag.add_connection("/bench", kind, typestore=store)
        for s, a, b in zip(t.tolist(), u.tolist(), y.tolist(), strict=True):
            bag.write(topic, 10**18 + round(1e9 * s), store.serialize_ros1(store.types[kind](s, a, b), kind))
    return folder / "log.bag"


PREAMBLE = "# bench A\n# date 2024-04-17\n"
EXPORT = "Instrument;XY-2000\nOperator;J. Smith, room 3\nSamples;3\n\n"

WAYS: Mapping[str, Writer] = {
    "semicolons": delimited(";"),
    "tabs": delimited("\t"),
    "bars": delimited("|"),
    "blanks": delimited("   "),
    "commas and blanks": delimited(" , "),
    "crlf": lambda folder, t, u, y: _write(folder, _text(_rows(t, u, y), end="\r\n")),
    "decimal commas": formed(_comma, ";"),
    "decimal commas, tabs": formed(_comma, "\t"),
    "decimal commas, blanks": formed(_comma, "  "),
    "quoted decimal commas": formed(lambda value: f'"{_comma(value)}"', ","),
    "thousands": formed(_thousands, ","),
    "thousands as Germans write": formed(_german, ";"),
    "thousands as the Swiss write": formed(lambda value: f"{value:,.3f}".replace(",", "'"), ";"),
    "thousands as the French write": formed(lambda v: f"{v:,.3f}".replace(",", "\u202f").replace(".", ","), ";"),
    "powers of ten": formed(lambda value: f"{value:.9E}", ","),
    "typeset minus": formed(lambda value: repr(value).replace("-", "\u2212"), ","),
    "utf-8 with a mark": encoded("utf-8", "\ufeff"),
    "utf-16": encoded("utf-16"),
    "utf-16 without a mark": encoded("utf-16-le"),
    "utf-16 of the other end": encoded("utf-16-be", "\ufeff"),
    "utf-32": encoded("utf-32"),
    "zeros of a power cut": lambda folder, t, u, y: _write(folder, _text(_rows(t, u, y)) + "\0" * 500),
    "comments above": above(PREAMBLE),
    "keys above": above(EXPORT, ";"),
    "numbers above": above("2000,1\n4,17\n"),
    "sep= of Excel": above("sep=;\n", ";"),
    "commented header": above("# "),
    "quoted names, blanks": lambda folder, t, u, y: _write(
        folder, _text(_rows(t, u, y), " ", tuple(f'"{name}"' for name in HEADER))
    ),
    "names of rows": lambda folder, t, u, y: _write(
        folder, _text([[f'"{k}"', *row] for k, row in enumerate(_rows(t, u, y))], header=('""', *HEADER))
    ),
    "units below": below("s,mm,deg"),
    "units in brackets below": below("[s],[mm],[°]"),
    "units and kinds below": below("s,mm,deg\nfloat,float,float"),
    "empty row below": below(""),
    "trailing commas": lambda folder, t, u, y: _write(folder, _text([[*row, ""] for row in _rows(t, u, y)])),
    "footer": with_footer,
    "channels of text": with_text_channels,
    "iso dates": dated("%Y-%m-%dT%H:%M:%S.%fZ"),
    "iso dates with a zone": dated("%Y-%m-%d %H:%M:%S.%f+02:00", "timestamp"),
    "iso dates, microseconds": dated("%Y-%m-%d %H:%M:%S.%f", "time", digits=6),
    "american dates": dated("%m/%d/%Y %I:%M:%S.%f %p"),
    "german dates": dated("%d.%m.%Y %H:%M:%S,%f", sign=";"),
    "dates of MATLAB": dated("%d-%b-%Y %H:%M:%S.%f", "Time"),
    "times of day over midnight": dated("%H:%M:%S.%f", "clock"),
    "a row an event": events,
    "Excel": sheet,
    "Excel with dates": sheet_of_dates,
    "Excel named .csv": workbook_named_csv,
    "LabVIEW": lvm("One"),
    "LabVIEW, decimal comma": lvm("One", ","),
    "LabVIEW, commas": lvm("One", sign=","),
    "LabVIEW without times": lvm("No"),
    "NumPy": numpy_named,
    "NumPy records": numpy_records,
    "MATLAB": matlab(time_s=lambda t, u, y: t, command=lambda t, u, y: u, angle_deg=lambda t, u, y: y),
    "MATLAB struct": matlab(run=lambda t, u, y: dict(zip(HEADER, (t, u, y), strict=True))),
    "TDMS": tdms(waveforms=False),
    "TDMS waveforms": tdms(waveforms=True),
    "TDMS of dates": tdms_of_dates,
    "MCAP": mcap,
    "ROS 1": ros1,
}
"""Every way in which the names of the columns say all."""

_SIGNALS = {"command": {"signal": "[1]", "unit": "mm"}, "angle": {"signal": "[2]", "unit": "deg"}}


def _of_matrix(name: str) -> dict[str, Any]:
    return {"time": f"{name}[0]", "command": f"{name}[1]", "angle": f"{name}[2]"}


def _dspace(t: Vec, u: Vec, y: Vec) -> Any:
    return {"X": {"Name": "Time", "Data": t}, "Y": [{"Name": "u", "Data": u}, {"Name": "y", "Data": y}]}


MAPPED: Mapping[str, tuple[Writer, dict[str, Any]]] = {
    "numbers alone": (
        lambda folder, t, u, y: _write(folder, _text(_rows(t, u, y)).partition("\n")[2]),
        {"time": "[0]", **_SIGNALS},
    ),
    "numbers below remarks": (
        lambda folder, t, u, y: _write(folder, "bench A, room 3\n\n" + _text(_rows(t, u, y)).partition("\n")[2]),
        {"time": "[0]", **_SIGNALS},
    ),
    "matrix of columns": (matlab(data=lambda t, u, y: np.column_stack((t, u, y))), _of_matrix("data")),
    "matrix of rows": (matlab(data=lambda t, u, y: np.vstack((t, u, y))), _of_matrix("data")),
    "matrix of a scope": (matlab(data=lambda t, u, y: np.vstack((t, u, y))[:, None, :]), _of_matrix("data")),
    "struct array": (
        matlab(out=lambda t, u, y: {"time": t, "signals": [{"values": u}, {"values": y}]}),
        {"time": "out.time", "command": "out.signals[0].values", "angle": "out.signals[1].values"},
    ),
    "dSPACE": (
        matlab(exp=_dspace),
        {"time": "exp.X[0].Data", "command": "exp.Y[0].Data", "angle": "exp.Y[1].Data"},
    ),
    "NumPy matrix": (
        lambda folder, t, u, y: (np.save(folder / "log.npy", np.vstack((t, u, y))), folder / "log.npy")[1],
        {"time": "[0]", **_SIGNALS},
    ),
    "micrometres": (
        lambda folder, t, u, y: _write(folder, _text(_rows(t, 1e3 * u, y), header=("t", "x (µm)", "w")), "latin-1"),
        {"time": "t", "command": {"signal": "x (µm)", "unit": "µm"}, "angle": {"signal": "w", "unit": "°"}},
    ),
    "milliseconds beside dates": (
        dated("%Y-%m-%d %H:%M:%S.%f", "stamp"),
        {"time": "stamp", "time_unit": "ms", "command": "command_mm", "angle": "angle_deg"},
    ),
}
"""Ways that need a mapping file."""


def archive(path: Path, parts: Mapping[str, bytes]) -> Path:
    """A ZIP archive, packed."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in parts.items():
            file.writestr(name, content)
    return path
