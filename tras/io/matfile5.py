"""MATLAB's files up to version 7 (-v6, -v7): their variables as arrays, texts, lists (cells) and dicts (structs).

`scipy.io.loadmat` does not serve here: of 20 000 damaged files it crashed the process on 59 and hung on 2, and a check
of sizes by `scipy.io.whosmat` still leaves 39 crashes. This reader allocates no more than the file's own content. It
passes over function handles, sparse and complex numbers, and objects but for the plain fields of those of the old kind,
such as an iddata, and of a few of the new kind (`tras.io.mcos`). Layout: MathWorks, "MAT-File Format".
"""

import struct
import zlib

import numpy as np

from tras.io import mcos
from tras.io.limits import MAX_COLUMNS, MAX_DEPTH, MAX_PARTS, MAX_VALUES, TOO_NESTED
from tras.io.roles import RecordingError
from tras.io.workspace import Instance, Unread

_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "ascii", 2: "ascii", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _HANDLE, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_NOT_WHOLE = "it ends in the middle of a variable; the file is not whole."
_LONGEST_NAME = 64  # characters of a field, with the zero at its end: MATLAB has 63


def read_variables(content: bytes) -> dict:
    """Name -> value of every variable, `Unread` for sparse, complex and object data; refuses damage, deep nesting."""
    endian = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if endian is None or struct.unpack(endian + "H", content[124:126])[0] != 0x0100:
        raise RecordingError("it is no MATLAB file of version 4 to 7.3; save it with -v7 or -v7.3.")
    reader, variables, position, store = _Reader(endian), {}, 128, None
    content = memoryview(content)
    while position < len(content):
        kind, body, position = reader.element(content, position, padded=False)
        if kind == _COMPRESSED:
            kind, body, _ = reader.element(reader.inflate(body), 0, padded=False)
        if kind != _MATRIX:
            raise _damage(f"element {kind} stands near byte {position}, where a variable should")
        name, value = reader.matrix(body, 0)
        if name in variables:
            raise _damage(f"the variable {name!r} is there twice")
        if name:
            variables[name] = value
        elif isinstance(value, np.ndarray):
            store = value
    return variables if store is None else mcos.resolved(variables, _objects(store))


def _objects(content):
    """The cells of the unnamed variable at a file's end, which is a file in the file; None if it is none."""
    content = memoryview(content.astype(np.uint8).tobytes(order="F"))
    endian = {b"IM": "<", b"MI": ">"}.get(bytes(content[2:4]))
    try:
        _, body, _ = _Reader(endian or "<").element(content, 8)
        _, value = _Reader(endian or "<").matrix(body, 0)
    except RecordingError:
        return None
    wrapper = value.get("MCOS") if isinstance(value, dict) else None
    return wrapper.content if isinstance(wrapper, Unread) else None


def _damage(what):
    return RecordingError(f"{what}; the file is damaged.")


class _Reader:
    """The byte order, and counts of what has been read."""

    def __init__(self, endian):
        self.endian, self.parts, self.values = endian, 0, 0

    def inflate(self, body):
        decompressor = zlib.decompressobj()
        try:
            content = decompressor.decompress(body, MAX_VALUES * 8)
        except zlib.error as error:
            raise RecordingError(f"its compressed part is damaged ({error}).") from error
        if not decompressor.eof:
            raise RecordingError("its compressed part is cut off, or larger than can be read.")
        if decompressor.unused_data:
            raise _damage("there are bytes after its compressed part")
        return content

    def element(self, data, position, padded=True):
        """(kind, content, position of the next one) of the element at ``position``."""
        if position + 8 > len(data):
            raise RecordingError(_NOT_WHOLE)
        kind, size = struct.unpack_from(self.endian + "II", data, position)
        if kind >> 16:  # up to four bytes, within the tag
            kind, size, start, end = kind & 0xFFFF, kind >> 16, position + 4, position + 8
            if size > 4:
                raise _damage("a small element claims more than four bytes")
        else:
            start, end = position + 8, position + 8 + size
            end += -size % 8 if padded or kind == _MATRIX else 0
        if start + size > len(data):
            raise RecordingError(_NOT_WHOLE)
        return kind, data[start : start + size], end

    def matrix(self, body, depth):
        """(name, value) of a variable, a cell's content or a struct's field."""
        self.parts += 1
        if depth > MAX_DEPTH or self.parts > MAX_PARTS:
            raise RecordingError(TOO_NESTED)
        if not body:
            return "", np.empty((0, 0))
        kind, flags, position = self.element(body, 0)
        if kind != 6 or len(flags) != 8:
            raise RecordingError("the flags of a variable are damaged.")
        flags = struct.unpack(self.endian + "II", flags)[0]
        number, is_complex = flags & 0xFF, flags & 0x0800
        if number == _OPAQUE:  # its content lies elsewhere in the file, in an order that MathWorks does not publish
            name, position = self.text(body, position)
            _, position = self.text(body, position)
            kind, position = self.text(body, position)
            try:
                content = self.inner(body, position, depth)[0]
            except RecordingError:
                content = None
            return name, Unread(f"an object ({kind[:60]})", kind[:60], content)
        dims, position = self.numbers(body, position)
        name, position = self.text(body, position)
        if number in (_SPARSE, _HANDLE) or is_complex:
            if number in (_SPARSE, _HANDLE):
                return name, Unread("a sparse matrix" if number == _SPARSE else "a function handle")
            real, position = self.numbers(body, position)
            imaginary, position = self.numbers(body, position)
            if real.size != imaginary.size or real.size != np.prod(dims, dtype=object):
                raise _damage(f"variable {name!r} has complex numbers that do not fit its size")
            self.values += 2 * real.size
            if self.values > MAX_VALUES:
                raise RecordingError(f"it has more than {MAX_VALUES} values.")
            return name, Unread("complex numbers", content=real + 1j * imaginary)
        dims = [int(d) for d in dims]
        if len(dims) < 2 or any(d < 0 for d in dims):
            raise _damage(f"variable {name!r} has the size {dims}")
        count = int(np.prod(dims, dtype=object))
        if number == _CELL:
            value, position = self.cells(body, position, count, depth)
        elif number == _STRUCT:
            value, position = self.structs(body, position, count, depth)
        elif number == _OBJECT:
            kind, position = self.text(body, position)
            value, position = self.structs(body, position, count, depth)
            value = Instance(kind, value) if isinstance(value, dict) else Unread(f"objects ({kind[:60]})", kind[:60])
        elif number == _CHAR:
            value, position = self.text(body, position)
        elif 6 <= number <= 15:
            self.values += count
            if self.values > MAX_VALUES:
                raise RecordingError(f"it has more than {MAX_VALUES} values.")
            value, position = self.numbers(body, position)
            if len(value) != count:
                raise _damage(f"variable {name!r} has {len(value)} numbers but the size {dims}")
            is_store = not name and not depth  # bytes of a file in the file
            value = (value if is_store else value.astype(float)).reshape(dims, order="F")
        else:
            raise _damage(f"variable {name!r} is of kind {number}, which MATLAB does not have")
        if position != len(body):
            raise _damage(f"variable {name!r} is longer or shorter than it says")
        return name, value

    def numbers(self, body, position):
        kind, content, position = self.element(body, position)
        dtype = _NUMBERS.get(kind)
        if dtype is None or len(content) % int(dtype[1]):
            raise _damage(f"there is an element of kind {kind} where numbers should be")
        return np.frombuffer(content, self.endian + dtype), position

    def text(self, body, position):
        kind, content, position = self.element(body, position)
        encoding = _TEXTS.get(kind)
        if encoding is None:
            raise _damage(f"there is an element of kind {kind} where text should be")
        if encoding[:5] in ("utf-1", "utf-3"):
            encoding += "-le" if self.endian == "<" else "-be"
        try:
            value = str(content, encoding)
        except UnicodeDecodeError as error:
            raise RecordingError(f"a text is damaged ({error}).") from error
        return value, position

    def cells(self, body, position, count, depth):
        if count * 8 > len(body):
            raise _damage(f"a cell array claims {count} cells, more than there are bytes for")
        values = []
        for _ in range(count):
            value, position = self.inner(body, position, depth)
            values.append(value)
        return values, position

    def structs(self, body, position, count, depth):
        """A dict, or a list of dicts for an array of structs."""
        length, position = self.numbers(body, position)
        kind, names, position = self.element(body, position)
        length = int(length[0]) if len(length) == 1 else 0
        if kind != 1 or not 1 <= length <= _LONGEST_NAME or len(names) % length:
            raise RecordingError("the names of a struct's fields are damaged.")
        if len(names) // length > MAX_COLUMNS:
            raise RecordingError(f"a struct has {len(names) // length} fields; up to {MAX_COLUMNS} are read.")
        names = str(names, "ascii", "replace")
        names = [names[i : i + length].split("\0")[0] for i in range(0, len(names), length)]
        if count * len(names) * 8 > len(body) or (not names and count > 1):
            raise _damage(f"a struct claims {count} entries, more than there are bytes for")
        if len(set(names)) != len(names):
            raise _damage("a struct has a field twice")
        values = []
        for _ in range(count):
            entry = {}
            for name in names:
                entry[name], position = self.inner(body, position, depth)
            values.append(entry)
        return (values[0] if count == 1 else values), position

    def inner(self, body, position, depth):
        kind, content, position = self.element(body, position)
        if kind != _MATRIX:
            raise _damage(f"there is an element of kind {kind} in a cell or struct")
        return self.matrix(content, depth + 1)[1], position
