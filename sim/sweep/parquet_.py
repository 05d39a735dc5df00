"""Tables as Parquet files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from .csv_rows import Column, as_column

ENDING = ".parquet"
_TYPES = {"number": pa.float64(), "whole": pa.int64(), "text": pa.string()}


def write(path: Path, rows: Sequence[Mapping[str, Any]], kinds: Mapping[str, str]) -> None:
    """Write rows; a column that a row lacks is empty there."""
    schema = pa.schema([(name, _TYPES[kind]) for name, kind in kinds.items()])
    plain = [{name: row.get(name) for name in kinds} for row in rows]
    pq.write_table(pa.Table.from_pylist(plain, schema=schema), path, compression="zstd")


def read(path: Path, names: Iterable[str]) -> dict[str, Column]:
    """Some columns of a file; one that it lacks is empty."""
    with pq.ParquetFile(path) as file:
        kept = [name for name in names if name in file.schema_arrow.names]
        table = file.read(columns=kept)
        count = file.metadata.num_rows
    found = {name: as_column(table.column(name).to_pylist(), kind_of(table, name)) for name in kept}
    return {name: found.get(name, as_column([None] * count, "text")) for name in names}


def kind_of(table: Any, name: str) -> str:
    """The kind of a column."""
    return next(kind for kind, known in _TYPES.items() if known == table.schema.field(name).type)


def kinds(path: Path) -> dict[str, str]:
    """Kinds of the columns of a file."""
    schema = pq.read_schema(path)
    back = {known: kind for kind, known in _TYPES.items()}
    return {field.name: back[field.type] for field in schema}


def merge(target: Path, parts: Sequence[tuple[Path, Sequence[int]]], columns: Mapping[str, str]) -> None:
    """Write chosen rows of several files as one, file by file, whole or not at all."""
    schema = pa.schema([(name, _TYPES[kind]) for name, kind in columns.items()])
    half = target.with_name(f".{target.name}.part")
    with pq.ParquetWriter(half, schema, compression="zstd") as writer:
        for path, chosen in parts:
            table = pq.read_table(path).take(pa.array(chosen, type=pa.int64()))
            arrays = [_cast(table, name, schema.field(name).type) for name in columns]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
    with half.open("rb+") as file:
        os.fsync(file.fileno())
    os.replace(half, target)


def _cast(table: Any, name: str, kind: Any) -> Any:
    if name not in table.schema.names:
        return pa.nulls(table.num_rows, type=kind)
    return table.column(name).cast(kind).combine_chunks()
