"""Models from others: hostile and damaged files are refused in one sentence that names them, in no time."""

import io
import json
import math
import zipfile

import numpy as np
import pytest
from conftest import at
from hypothesis import given, settings
from hypothesis import strategies as st

import tras
from tras.dictionaries.mechanical import _powers
from tras.model_file import MAX_FUNCTIONS


@pytest.fixture(scope="module")
def recording():
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1, 1, (6, 40, 2)), rng.uniform(-1, 1, (6, 40, 1))
    for k in range(39):
        x[:, k + 1] = 0.9 * x[:, k] + 0.05 * u[:, k] + 0.01 * x[:, k + 1]
    return tras.Recording(x, u, 0.1)


@pytest.fixture(scope="module")
def models(recording):
    return {
        "field": tras.KoopmanModel(tras.Monomials(2), strength=1e-3).fit(recording),
        "mechanical": tras.KoopmanModel(tras.Mechanical(2), strength=1e-3).fit(recording),
        "rbf": tras.KoopmanModel(tras.GaussianRBF(3), "one_step", 1, strength=1e-3).fit(recording),
        "linear": tras.KoopmanModel(tras.Fourier(), "lifted_linear", strength=1e-3).fit(recording),
        "union": tras.KoopmanModel(tras.Union(tras.Monomials(2), tras.ThinPlate(2)), "one_step", strength=1e-3).fit(
            recording
        ),
        "product": tras.KoopmanModel(tras.Product(tras.Monomials(1), tras.Fourier()), "one_step", strength=1e-3).fit(
            recording
        ),
    }


def stored(model, path):
    """(header, arrays) of a model's file."""
    model.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    return json.loads(str(arrays.pop("header"))), arrays


def refused(path, words):
    with pytest.raises(ValueError, match=words) as caught:
        tras.load_model(path)
    sentence = str(caught.value)
    assert sentence.startswith(f"{path} cannot be read as a model (") and "\n" not in sentence and len(sentence) < 400


def lowest(array):
    """A number so low that the difference to the next one overflows."""
    array = array.copy()
    array[-2] = -(2**63)
    return array


ARRAYS = {
    "NaN in W": ("field", "W_", at(3, np.nan), "its W_ holds a number that is not finite"),
    "infinity in K": ("field", "koopman_matrix", at(0, np.inf), "its koopman_matrix holds a number"),
    "a huge number in the generator": ("field", "generator", at(0, 1e200), "its generator holds a number"),
    "NaN in B": ("linear", "B_", at(0, np.nan), "its B_ holds a number"),
    "NaN in the hull": ("field", "hull.low", at(0, np.nan), "its hull.low holds a number"),
    "a hull inside out": ("field", "hull.low", at(0, 1e3), "its hull is no box"),
    "axes that are none": ("field", "hull.axes", at(0, 9.0), "its hull is no box along orthogonal axes"),
    "a hull of others": ("field", "hull.centre", lambda a: a[:-1], "its hull is not one of its 3 channels"),
    "NaN in the slopes": ("field", "outward_", at(0, np.nan), "its outward_ holds a number"),
    "a scale of zero": ("field", "x_scale_", at(0, 0.0), "its x_scale_ holds a number"),
    "a negative scale": ("field", "u_scale_", at(0, -1.0), "its u_scale_ holds a number"),
    "NaN in an offset": ("field", "x_offset_", at(1, np.nan), "its x_offset_ holds a number"),
    "a scale too many": ("field", "x_scale_", lambda a: np.ones(3), "its x_scale_ has the shape .3,. in place of .2"),
    "substeps without end": ("field", "substeps_", lambda a: np.array(10**12), "its substeps_ is 10+, a model has 1"),
    "no substeps": ("field", "substeps_", lambda a: np.array(0), "its substeps_ holds a number"),
    "substeps that are no number": ("field", "substeps_", lambda a: np.array("x"), "its substeps_ holds no numbers"),
    "half a step": ("field", "substeps_", lambda a: np.array(1.5), "its substeps_ is 1.5"),
    "W of another shape": ("field", "W_", lambda a: a.T, "its W_ has the shape"),
    "K of one function": ("rbf", "koopman_matrix", lambda a: a[:1], "its koopman_matrix has the shape"),
    "complex numbers": ("field", "W_", lambda a: a.astype(complex), "its entry 'W_.npy' is no plain array"),
    "a matrix that is not there": ("field", "W_", lambda a: None, "it lacks 'W_'"),
    "NaN among the centres": ("rbf", "dictionary.centres_", at(0, np.nan), "its dictionary.centres_ holds a number"),
    "a width of zero": ("rbf", "dictionary.width_", lambda a: np.array(0.0), "its dictionary.width_ holds a number"),
    "centres of others": ("rbf", "dictionary.centres_", lambda a: a[:, :-1], "its dictionary.centres_ has the shape"),
    "other states": ("rbf", "dictionary.n_states_", lambda a: np.array(7), "its dictionary is not of 5 states"),
    "a billion states": ("field", "dictionary.n_states_", lambda a: np.array(10**9), "is not of 2 states"),
    "states with a point": ("rbf", "dictionary.n_states_", lambda a: a.astype(float), "is not of 5 states"),
    "the least whole number": ("union", "dictionary.kept_", lowest, "chooses functions that its parts do not"),
    "functions that are not there": ("union", "dictionary.kept_", at(-1, 99), "chooses functions that its parts"),
    "half functions": ("union", "dictionary.kept_", at(-1, 9.5), "chooses functions that its parts do not"),
    "no functions": ("product", "dictionary.kept_", lambda a: a[:2], "chooses functions that its parts do not"),
    "an empty refinement": ("field", "refinement_", lambda a: np.ones(0), "its refinement_ is empty"),
    "a method of the dictionary": ("field", "dictionary.lift_", lambda a: np.ones(2), "its dictionary .* has learnt"),
    "something else": ("field", "os", lambda a: np.ones(2), "it holds 'os', which is no part of such a model"),
    "B of another predictor": ("field", "B_", lambda a: np.ones((10, 1)), "it holds 'B_', which is no part of such"),
}  # fmt: skip


@pytest.mark.parametrize("what", ARRAYS)
def test_arrays_out_of_range_are_refused(what, models, tmp_path):
    name, key, change, words = ARRAYS[what]
    header, arrays = stored(models[name], tmp_path / "good.npz")
    arrays[key] = change(arrays.get(key))
    if arrays[key] is None:
        del arrays[key]
    np.savez(tmp_path / "bad.npz", header=np.array(json.dumps(header)), **arrays)
    refused(tmp_path / "bad.npz", words)


def inner(header, *keys):
    for key in keys:
        header = header[key]
    return header


HEADERS = {
    "a degree of 3 000": ("field", ["dictionary", "parameters", "degree"], 3000, "degree is 3000; give"),
    "a degree of 100 000": ("field", ["dictionary", "parameters", "degree"], 100_000, "degree is 100000; give"),
    "a degree of 300": ("field", ["dictionary", "parameters", "degree"], 300, "more than 10000 functions"),
    "unsettled by number": ("field", ["unsettled"], [3], "its unsettled are no list of sentences"),
    "unsettled at length": ("field", ["unsettled"], ["a" * 2000], "its unsettled are no list of sentences"),
    "a degree of zero": ("field", ["dictionary", "parameters", "degree"], 0, "its dictionary Monomials has degree = 0"),
    "a degree in words": ("field", ["dictionary", "parameters", "degree"], "two", "has degree = 'two'"),
    "another degree": ("field", ["dictionary", "parameters", "degree"], 3, "has 20 functions, its header names 10"),
    "a high degree": ("mechanical", ["dictionary", "parameters", "degree"], 10**6, "degree is 1000000; give"),
    "a shape many times": ("mechanical", ["dictionary", "parameters", "shape"], [0] * 30, "each once"),
    "an order without end": ("linear", ["dictionary", "parameters", "order"], 10**9, "order is 1000000000; give"),
    "an endless period": ("linear", ["dictionary", "parameters", "period"], math.inf, "has period = inf"),
    "hardly a period": ("linear", ["dictionary", "parameters", "period"], 1e-320, "has period = 1e-320"),
    "no seed": ("rbf", ["dictionary", "parameters", "seed"], -1, "has seed = -1"),
    "another parameter": ("field", ["dictionary", "parameters", "os"], 1, "has os = 1"),
    "a name that is a list": ("field", ["dictionary", "name"], ["Monomials"], "is not one of this release"),
    "no parts": ("union", ["dictionary", "parts"], [], "is not made of the parts that it needs"),
    "three parts": ("product", ["dictionary", "parts"], [{}] * 101, "is not made of the parts that it needs"),
    "a sampling time of zero": ("field", ["dt"], 0.0, "its dt is 0.0; give a number"),
    "a sampling time in words": ("field", ["dt"], "fast", "its dt is 'fast'"),
    "an endless sampling time": ("field", ["dt"], math.inf, "its dt is inf"),
    "no sampling time": ("field", ["dt"], math.nan, "its header holds NaN"),
    "delays without end": ("rbf", ["parameters", "delays"], 10**9, "its delays is 1000000000"),
    "other delays": ("rbf", ["parameters", "delays"], 2, "its predictor or delays are not those of a model"),
    "another predictor": ("field", ["parameters", "predictor"], "magic", "its predictor or delays are not those"),
    "another option": ("field", ["parameters", "os"], 1, "its header or an array is not of the kind"),
    "a field that does not exist": ("field", ["parameters", "field"], "magic", "field is 'magic'; choose one of"),
    "a name twice": ("field", ["state_names"], ["a", "a"], "its channels have no names, or one twice"),
    "half a letter": ("field", ["state_names"], ["a", "\ud800"], "its state_names are no list of texts"),
    "a unit too few": ("field", ["state_units"], ["m"], "its channels and units are not one for one"),
    "names that are numbers": ("field", ["names"], [1, 2], "its names are no list of texts"),
    "no functions": ("field", ["names"], [], "it has 0 functions"),
    "functions without end": ("field", ["names"], ["a"] * (MAX_FUNCTIONS + 1), "it has 10001 functions"),
    "pairs": ("field", ["pairs"], -1, "its pairs is -1"),
    "the rank": ("field", ["rank"], 10**12, "its rank is 1000000000000"),
    "the strength": ("field", ["strength"], -1.0, "its strength is -1.0"),
    "errors": ("field", ["errors"], [["a", 1.0]], "its errors are no pairs"),
    "free channels": ("field", ["free"], [99], "its hull is not one of its 3 channels"),
    "no parameters": ("field", ["parameters"], None, "its header or an array is not of the kind"),
    "no dictionary": ("field", ["dictionary"], [], "its header or an array is not of the kind"),
}  # fmt: skip


@pytest.mark.parametrize("what", HEADERS)
def test_headers_out_of_range_are_refused(what, models, tmp_path):
    name, keys, value, words = HEADERS[what]
    header, arrays = stored(models[name], tmp_path / "good.npz")
    inner(header, *keys[:-1])[keys[-1]] = value
    np.savez(tmp_path / "bad.npz", header=np.array(json.dumps(header)), **arrays)
    refused(tmp_path / "bad.npz", words)


def test_dictionaries_in_dictionaries_end(models, tmp_path):
    header, arrays = stored(models["union"], tmp_path / "good.npz")
    for _ in range(30):
        header["dictionary"] = {"name": "Union", "parameters": {"parts": None}, "parts": [header["dictionary"]]}
    np.savez(tmp_path / "bad.npz", header=np.array(json.dumps(header)), **arrays)
    refused(tmp_path / "bad.npz", "is not made of the parts that it needs")


def test_no_product_of_many_functions(recording, models, tmp_path):
    """Two parts that may be stored give a product that may not."""
    header, arrays = stored(models["product"], tmp_path / "good.npz")
    for part in header["dictionary"]["parts"]:
        part["name"], part["parameters"] = "Monomials", {"degree": 8}
    np.savez(tmp_path / "bad.npz", header=np.array(json.dumps(header)), **arrays)
    refused(tmp_path / "bad.npz", "its dictionary has 27225 functions in its parts, up to 10000 are read")


def npy(shape, content=b"", kind="<f8"):
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + content


def packed(entries, method=zipfile.ZIP_STORED):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in entries.items():
            archive.writestr(zipfile.ZipInfo(name), content, method)
    return file.getvalue()


def patched(content, signature, offset, value):
    """The file with bytes changed behind the first record of its list of entries."""
    place = content.index(signature) + offset
    return content[:place] + value + content[place + len(value) :]


def header_of(text):
    return npy("()", text.encode("utf-32-le"), f"<U{len(text)}")


PLAIN = packed({"header.npy": header_of("{}"), "a.npy": npy("(2,)", bytes(16))})
ENTRY = b"PK\x01\x02"
FILES = {
    "nothing": (b"", "is no .npz file, or its end is missing"),
    "a bomb": (packed({"a.npy": npy("(10000000,)", bytes(8 * 10**7))}, zipfile.ZIP_DEFLATED), "'a' is compressed"),
    "bzip2": (packed({"a.npy": npy("(2,)", bytes(16))}, zipfile.ZIP_BZIP2), "'a' is compressed"),
    "an unknown compression": (patched(PLAIN, ENTRY, 10, b"\x63\x00"), "is compressed, which our files are not"),
    "encryption": (patched(PLAIN, ENTRY, 8, b"\x01\x00"), "'header' is encrypted"),
    "strong encryption": (patched(PLAIN, ENTRY, 8, b"\x40\x00"), "'header' is encrypted"),
    "a patch": (patched(PLAIN, ENTRY, 8, b"\x20\x00"), "compressed patched data"),
    "another checksum": (patched(PLAIN, ENTRY, 16, b"\x01\x02\x03\x04"), "Bad CRC-32"),
    "a size that is not there": (patched(PLAIN, ENTRY, 20, b"\xff\xff\xff\x0f" * 2), "are larger than the file"),
    "cut off": (PLAIN[:-30], "its end is missing"),
    "a comment": (PLAIN[:-2] + b"\x05\x00hello", "its end is missing"),
    "many entries": (packed({f"{k}.npy": b"" for k in range(1001)}), "1001 entries, up to 1000 are read"),
    "a million entries": (PLAIN[:-14] + b"\xff\xff" * 2 + PLAIN[-10:], "65535 entries"),
    "a list elsewhere": (PLAIN[:-6] + bytes(6), "its list of entries is damaged"),
    "an entry that is no array": (packed({"a.txt": b"hello"}), "its entry 'a.txt' is no array"),
    "no header": (packed({"a.npy": npy("(2,)", bytes(16))}), "it holds no header"),
    "a header of numbers": (packed({"header.npy": npy("(2,)", bytes(16))}), "its header is no text"),
    "a header of no letters": (packed({"header.npy": npy("()", b"\xff" * 8, "<U2")}), "its header is no text"),
    "letters that are none": (packed({"header.npy": npy("()", b"\x00\x00\x11\x00", "<U1")}), "its header is no text"),
    "half a letter": (packed({"header.npy": npy("()", b"\x00\xd8\x00\x00", "<U1")}), "its header is no text"),
    "a header that is no JSON": (packed({"header.npy": header_of("{")}), "Expecting property name"),
    "a deep header": (packed({"header.npy": header_of("[" * 10**6)}), "its header is nested too deep"),
    "a huge header": (packed({"header.npy": header_of(" " * (2**22 + 1))}), "has more than 4194304 letters"),
    "a number of 5 000 digits": (packed({"header.npy": header_of("9" * 5000)}), "Exceeds the limit"),
    "a header without a format": (packed({"header.npy": header_of("{}")}), "its header names no format"),
    "a format that is no text": (packed({"header.npy": header_of('{"format": [1]}')}), "its header names no format"),
    "a header that is a list": (packed({"header.npy": header_of("[]")}), "its header names no format"),
}  # fmt: skip
MODEL = '{"format": "tras model 2"}'
ENTRIES = {
    "10^12 numbers": (npy("(1000000000000,)"), "another size than its shape .1000000000000,. needs"),
    "no number, endless": (npy("(0, 1000000000000, 1000000000000, 1000000000000)"), "array is too big|too large|lacks"),
    "many axes": (npy(f"({', '.join('1' * 100)})", bytes(8)), "maximum supported dimension"),
    "objects": (npy("(2,)", bytes(16), "|O"), "its entry 'a.npy' is no plain array"),
    "text without letters": (npy("(9,)", b"", "<U0"), "is no plain array"),
    "a negative length": (npy("(-1,)", bytes(16)), "is no plain array"),
    "code for a shape": (npy("(2, *[2]*9)", bytes(16)), "is no plain array"),
    "another version": (npy("(2,)", bytes(16)).replace(b"NUMPY\x01", b"NUMPY\x03"), "is no plain array"),
    "nothing": (b"", "is no plain array"),
    "a number too few": (npy("(2,)", bytes(8)), "another size than its shape .2,. needs"),
}  # fmt: skip


@pytest.mark.parametrize("what", FILES)
def test_hostile_files_are_refused(what, tmp_path):
    content, words = FILES[what]
    (tmp_path / "bad.npz").write_bytes(content)
    refused(tmp_path / "bad.npz", words)


@pytest.mark.parametrize("what", ENTRIES)
def test_hostile_entries_are_refused(what, tmp_path):
    content, words = ENTRIES[what]
    (tmp_path / "bad.npz").write_bytes(packed({"header.npy": header_of(MODEL), "a.npy": content}))
    refused(tmp_path / "bad.npz", words)


@pytest.mark.parametrize("name", ["field", "mechanical", "rbf", "linear", "union", "product"])
def test_what_is_saved_is_read(name, models, recording, tmp_path):
    models[name].save(tmp_path / "good.npz")
    again = tras.load_model(tmp_path / "good.npz")
    assert np.array_equal(again.predict(recording), models[name].predict(recording))


def test_nothing_is_saved_that_could_not_be_read(recording, tmp_path):
    model = tras.KoopmanModel(tras.Monomials(1), strength=1e-3).fit(recording)
    model.W_ = model.W_ * np.nan
    with pytest.raises(ValueError, match="the model cannot be saved: its W_ holds a number that is not finite"):
        model.save(tmp_path / "bad.npz")
    assert not list(tmp_path.iterdir())


KINDS = st.one_of(
    st.builds(tras.Monomials, st.integers(1, 4)),
    st.builds(tras.Fourier, st.integers(1, 3)),
    st.builds(tras.Exponentials, st.integers(1, 3)),
    st.builds(tras.GaussianRBF, st.integers(1, 5)),
    st.builds(tras.Mechanical, st.integers(1, 5), shape=st.sampled_from([None, [0], [0, 2], [2]])),
)


@settings(deadline=None)
@given(KINDS, st.sampled_from([2, 4]), st.integers(0, 3))
def test_functions_are_counted_before_they_are_built(dictionary, n, m):
    if getattr(dictionary, "shape", None) and 2 in dictionary.shape and n == 2:
        dictionary.shape = None
    rng = np.random.default_rng(0)
    dictionary.fit(rng.uniform(-1, 1, (9, n)), rng.uniform(-1, 1, (9, m)))
    assert dictionary.count() == dictionary.size == len(dictionary.names)


def test_powers_are_those_of_the_whole_box_in_order():
    box = np.ndindex(5, 5, 5)
    assert _powers(3, 4) == [k for k in box if sum(k) <= 4]
