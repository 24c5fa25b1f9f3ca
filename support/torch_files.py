"""Files in torch's format that may come from strangers: nothing in them is executed.

Such a file is a zip archive: the bytes of each tensor, and a pickle that says what they are. A
pickle is a program. It is looked through before it runs, and may do nothing but make plain values:
dicts, lists, text, numbers and descriptions of tensors. Tensors are made from these afterwards, as
copies, and only where the file holds all their bytes.
"""

import io
import math
import pickle
import pickletools
import warnings
import zipfile
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import torch

from scenes.limits import shown_path
from support.run_folder import RunError

# What torch.save writes for plain values and tensors.
STEPS = {"PROTO", "STOP", "MARK", "NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2",
         "LONG1", "BINFLOAT", "BINUNICODE", "EMPTY_LIST", "APPEND", "APPENDS", "EMPTY_DICT",
         "SETITEM", "SETITEMS", "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "GLOBAL",
         "REDUCE", "BINPERSID", "BINPUT", "LONG_BINPUT", "BINGET", "LONG_BINGET"}
DTYPES = {"DoubleStorage": torch.float64, "FloatStorage": torch.float32,
          "LongStorage": torch.int64, "IntStorage": torch.int32, "ShortStorage": torch.int16,
          "CharStorage": torch.int8, "ByteStorage": torch.uint8, "BoolStorage": torch.bool}
MOST_AXES = 8  # of a tensor, our choice
# A step may be one byte and take a hundred: a file has at most a step to so many of the bytes that
# it may have, our choice.
BYTES_A_STEP = 8
MOST_STEPS = 2 ** 23  # and never more than so many, our choice: 300,000 rows of a training's tables
KEYS = (str, int, float, bool, type(None))  # types of a dict's keys


class Refused(Exception):
    """What is in the file is not what torch.save writes for plain values and tensors."""


@dataclass(frozen=True, eq=False)
class Described:
    """A tensor as the pickle describes it. data: the bytes of its storage, of that dtype."""
    dtype: torch.dtype
    data: bytearray
    offset: int = 0
    size: tuple = ()
    stride: tuple = ()


def read_torch_file(path, largest):
    """The dict that a file holds, its tensors as copies in memory. largest: the bytes that it may
    have. Raises RunError."""
    path = Path(path)
    what = shown_path(path)
    try:
        if not path.is_file():
            raise RunError(f"{what} is no file")
        if path.stat().st_size > largest:
            raise RunError(f"{what} has more than {largest:,} bytes, the most that it may have")
        content = path.read_bytes()
    except OSError as error:
        raise RunError(f"{what} cannot be read: {error.strerror}") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of libraries, about what is refused anyway
            return dict_of(content, min(largest // BYTES_A_STEP, MOST_STEPS))
    except Exception:  # of zipfile, pickle and torch, whatever is wrong: nothing else happens here
        raise RunError(f"{what} is no whole file of this version of the program") from None


def dict_of(content, steps):
    """The dict that the bytes of a file hold. steps: how many its pickle may have. Raises any
    Exception."""
    members = read_members(content)
    [name] = [name for name in members if name.split("/")[1:] == ["data.pkl"]]
    folder = name.split("/")[0]
    if members.get(f"{folder}/byteorder", b"little") != b"little":
        raise Refused
    look_through(members[name], steps)
    saved = Reader(members[name], folder, members).load()
    if type(saved) is not dict:
        raise Refused
    return Maker(items=len(members[name]), size=len(content)).make(saved)


def read_members(content):
    """The members of a zip archive, name -> bytearray, none of them compressed: together they
    are no larger than the archive. zipfile compares their checksums. Raises any Exception."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        if any(member.compress_type != zipfile.ZIP_STORED for member in members):
            raise Refused
        if sum(member.file_size for member in members) > len(content):
            raise Refused
        if len({member.filename for member in members}) < len(members):
            raise Refused
        return {member.filename: bytearray(archive.read(member)) for member in members}


def look_through(program, most):
    """Checks the steps of a pickle before it runs: there may be so many. Raises any Exception.

    A tuple may be used once: tuples in tuples could double again and again, and a dict that has
    such a key would never be done with it."""
    tuples = set()  # places in the pickle's memory
    on_top = False  # whether a tuple is what was made last
    for k, (step, argument, _) in enumerate(pickletools.genops(program)):
        if k >= most or step.name not in STEPS:
            raise Refused
        if step.name in ("BINPUT", "LONG_BINPUT"):
            if argument > len(program):  # memory is taken up to there
                raise Refused
            if on_top:
                tuples.add(argument)
        else:
            on_top = step.name in ("TUPLE", "TUPLE1", "TUPLE2", "TUPLE3")
        if step.name in ("BINGET", "LONG_BINGET") and argument in tuples:
            raise Refused


class Reader(pickle.Unpickler):
    """Runs a pickle that was looked through. Whatever it names is ours, or is refused."""

    def __init__(self, program, folder, members):
        super().__init__(io.BytesIO(program))
        self._folder = folder
        self._members = members

    def find_class(self, module, name):
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return describe
        if (module, name) == ("collections", "OrderedDict"):
            return no_hooks
        if module == "torch" and name in DTYPES:
            return DTYPES[name]
        raise Refused

    def persistent_load(self, pid):
        """A storage. pid: ("storage", dtype, name, device, number of values)."""
        _, dtype, name, _, count = pid
        data = self._members[f"{self._folder}/data/{name}"]
        if len(data) != count * dtype.itemsize:
            raise Refused
        return Described(dtype, data)


def describe(storage, offset, size, stride, requires_grad, hooks, metadata=None):
    """In the place of torch's own function, which would make the tensor."""
    return Described(storage.dtype, storage.data, offset, size, stride)


def no_hooks():
    """In the place of OrderedDict: the hooks of a tensor, of which there are none."""
    return OrderedDict()


class Maker:
    """Makes tensors of their descriptions, in dicts and lists."""

    def __init__(self, items, size):
        """items, size: how many things and how many bytes of tensors there may be: as many as the
        file has, however often it uses one."""
        self._items = items
        self._size = size
        self._longest = size  # and what a tensor's sizes and strides may be

    def make(self, content):
        """The content with tensors. Raises any Exception."""
        self._items -= 1
        if self._items < 0:
            raise Refused
        if type(content) is dict:
            if any(type(key) not in KEYS for key in content):
                raise Refused
            return {key: self.make(value) for key, value in content.items()}
        if type(content) in (list, tuple):
            return type(content)([self.make(value) for value in content])
        if type(content) is Described:
            return self._tensor(content)
        if type(content) not in KEYS:
            raise Refused
        return content

    def _tensor(self, described):
        """A tensor, a copy."""
        size, stride = described.size, described.stride
        numbers = (described.offset, *size, *stride)
        if len(size) != len(stride) or len(size) > MOST_AXES:
            raise Refused
        if any(type(n) is not int or not 0 <= n <= self._longest for n in numbers):
            raise Refused
        dtype = described.dtype
        self._size -= math.prod(size) * dtype.itemsize
        if self._size < 0:
            raise Refused
        if math.prod(size) == 0:
            return torch.zeros(size, dtype=dtype)
        if dtype == torch.bool:  # bytes other than 0 and 1 would be neither true nor false
            return self._view(described, torch.uint8).bool()
        return self._view(described, dtype).clone()

    def _view(self, described, dtype):
        """The values where they lie in the storage. torch refuses those beyond its end."""
        values = torch.frombuffer(described.data, dtype=dtype)
        return values.as_strided(described.size, described.stride, described.offset)
