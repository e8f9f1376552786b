"""Damaged files and any text: what is refused is refused in a sentence, and leaves nothing behind."""

import base64
import tomllib
import warnings
import zipfile
import zlib

import h5py
import hypothesis
import hypothesis.strategies as st
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from configs import ConfigError
from rig.exchange.guess.proposal import propose
from rig.exchange.importing import import_recording
from rig.exchange.mapping import read_mapping
from rig.recording import RecordingError
from rig.runlog import RunError
from tests.rig.runlog.test_runlog_import import SIMPLE, TDMS, put, waveforms, workbook  # noqa: F401 - a fixture

SHEET = (
    '<worksheet MAIN><sheetData><row r="1"><c r="A1" t="inlineStr"><is><t>P</t></is></c>'
    '<c r="B1" t="inlineStr"><is><t>n</t></is></c></row>'
    '<row r="2"><c r="A2"><v>2.0</v></c><c r="B2"><v>397</v></c></row></sheetData></worksheet>'
)


def write_mdf(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF, Signal
    with MDF() as file:
        time = 0.1 * np.arange(5.0)
        file.append([Signal(np.arange(2.0, 7.0), time, name=name) for name in "Pn"], common_timebase=True)
        file.save(path)


def write_hdf5(path):
    with h5py.File(path, "w") as file:
        file["P"] = np.arange(2.0, 7.0)
        file.create_dataset("n", data=np.arange(2.0, 7.0), compression="gzip")


def write_workbook(path):
    """Deflated, as a spreadsheet program does it."""
    workbook(path, SHEET)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)


@pytest.fixture(scope="module")
def whole_files(tmp_path_factory):
    """The bytes of a sound file of each format."""
    folder = tmp_path_factory.mktemp("whole")
    waveforms(folder / "data.tdms", P=0.0, n=0.0)
    savemat(folder / "data.mat", {"P": np.arange(2.0, 7.0), "n": np.arange(2.0, 7.0)})
    write_hdf5(folder / "data.hdf5")
    write_mdf(folder / "data.mf4")
    (folder / "data.mf4").rename(folder / "data.mdf")
    write_workbook(folder / "data.xlsx")
    pq.write_table(pa.table({"P": np.arange(2.0, 7.0), "n": np.arange(2.0, 7.0)}), folder / "data.parquet")
    return {path.suffix[1:]: path.read_bytes() for path in folder.iterdir()}


def mapping_of(reader):
    return TDMS.replace("tdms", reader) + ('sheet = "one"\n' if reader == "xlsx" else "") + SIMPLE


def read_or_refused(folder, content, reader):
    """Import a file; what is refused is refused in words, and leaves nothing behind."""
    (folder / "elsewhere.toml").write_text(mapping_of(reader))
    (folder / "data").write_bytes(content)
    try:
        import_recording([folder / "data"], read_mapping(folder / "elsewhere.toml"), folder / "out")
        return True
    except (RunError, RecordingError) as error:
        assert str(error)
        assert not (folder / "out").exists()
        return False


@st.composite
def damaged(draw, content):
    """Bytes with some of them changed, some left out, the end cut off."""
    found = bytearray(content)
    for _ in range(draw(st.integers(0, 4))):
        found[draw(st.integers(0, len(found) - 1))] = draw(st.integers(0, 255))
    at, gone = draw(st.integers(0, len(found) - 1)), draw(st.sampled_from([0, 0, 1, 7]))
    del found[at : at + gone]
    return bytes(found[: draw(st.integers(1, len(found)))] if draw(st.booleans()) else found)


@pytest.mark.parametrize("reader", ["tdms", "mat", "hdf5", "mdf", "parquet", "xlsx"])
def test_a_file_that_was_cut_off_is_refused(reader, whole_files, tmp_path):
    assert not read_or_refused(tmp_path, whole_files[reader][:-400], reader)


PROCESSES = [pytest.param(reader, 20, marks=pytest.mark.long) for reader in ("tdms", "mat", "hdf5", "mdf", "parquet")]


@pytest.mark.parametrize(("reader", "times"), [("xlsx", 40), *PROCESSES])
def test_no_damaged_file_ends_in_anything_but_a_sentence(reader, times, whole_files, tmp_path_factory):
    assert read_or_refused(tmp_path_factory.mktemp("sound"), whole_files[reader], reader)

    @hypothesis.given(content=damaged(whole_files[reader]))
    @hypothesis.settings(max_examples=times, derandomize=True, deadline=None, database=None)
    def read(content):
        read_or_refused(tmp_path_factory.mktemp("damaged"), content, reader)

    read()


def test_a_file_that_takes_its_reader_down_is_refused(whole_files, put, tmp_path):  # noqa: F811 - the fixture
    """scipy's compiled reader ends its process over this byte."""
    content = bytearray(whole_files["mat"])
    content[176] = 49
    mapping = read_mapping(put("elsewhere.toml", mapping_of("mat")))
    with pytest.raises(RunError, match=r"(?i)damaged.mat: not a mat(lab)? file that can be read"):
        import_recording([put("damaged.mat", bytes(content))], mapping, tmp_path / "out")


# An HDF5 file with one byte put in, over which the library goes round in circles; compressed.
ENDLESS = (
    r"""c-rgqaB<`1lHy|K;9!7(|4?v50>U?dim%((ecIo{C5VZkf=LKjAq;RaF)%VPu<<YeDaL^Pj1X;5eqI&}l+O?3b1*U%b1>)!=$9qt"""
    r"""l%}%rfs`<pBqnjPK`j$zzy^*gbJT#H05p(Mgn@yHk&%%VDhH#PMHm<b73>)x9&%tX;bt)T&kU3Yx{jHP1L$&QMyMo%2F&0M3_}k5"""
    r"""+{?2Q92N>IR&Zt`WBk!0019hXaJX+~K#CFumXgfeRAB5vfFT)9dXPG^of^@jffhZYLJTaJ{^2nPs%2nf5CKV+=4F-?Ge|NrG64Mt"""
    r"""#*pO4!N3G%2S5!4u~D=Zmn0UI;MB^6q!k=CD#V2a*S_^_)Ch|JiJ_lVpRX+Pq%f(*F=Hgvzbq6aRgO4iUur~8g#-<gDl_>>m4$?)"""
    r"""n)<dZ3_UEE84ykY(^?FSVL(fOg*iha0|T~TNn+p-W`x*`96}4AAq02KtihaAPs};-lwrgH2WX~%(gILg1WHRdpep}hk4vAsv%e2G"""
    r"""NeUneTV%SJ0jVT~CRq?LGB7gHH82Ds)MSUQkAa1NMi^+|XBY*eU=)mkQ7{Td!6+C7qhJ(_f>AIEM!}#MP{2KqfT|up0094M$FK"""
)


@pytest.mark.long
def test_a_file_that_sends_its_reader_round_in_circles_is_refused(put, tmp_path, monkeypatch):  # noqa: F811 - the fixture
    monkeypatch.setattr("rig.exchange.binary.apart.MOST_CPU_S", 2)
    columns = mapping_of("hdf5").replace('"P"', '"P/value"').replace('"n"', '"n/value"')
    mapping = read_mapping(put("elsewhere.toml", columns + '[columns.time_s]\ncolumn = "@time"\nunit = "s"\n'))
    with pytest.raises(RunError, match=r"damaged\.h5"):
        import_recording([put("damaged.h5", zlib.decompress(base64.b85decode(ENDLESS)))], mapping, tmp_path / "out")


CELLS = ("2,0", "397", "", "OL", '"', "\n", ";", ",", "\t", "1e400", "-5", "12:00:00", "\x00", "٣", "Druck [kPa]", "up")
TEXTS = st.lists(st.sampled_from(CELLS), max_size=40).map(lambda cells: ";".join(cells).encode())
WRONG = ("rows = [1, 2]", "[[files]]", "[files]", "rotameter = {}", "unit = 3", "=")
LINES = st.sampled_from([*mapping_of("csv").splitlines(), *WRONG])


@hypothesis.given(content=st.one_of(TEXTS, st.binary(max_size=80)))
@hypothesis.settings(max_examples=25, derandomize=True, deadline=None, database=None)
def test_a_guess_is_a_mapping_s_text_or_a_refusal(content, tmp_path_factory):
    path = tmp_path_factory.mktemp("any") / "data"
    path.write_bytes(content)
    try:
        text = propose(path)
    except RunError as error:
        assert str(error)
    else:
        tomllib.loads(text)


@hypothesis.given(lines=st.lists(LINES, max_size=25))
@hypothesis.settings(max_examples=40, derandomize=True, deadline=None, database=None)
def test_a_mapping_is_read_or_refused_in_words(lines, tmp_path_factory):
    path = tmp_path_factory.mktemp("any") / "map.toml"
    path.write_text("\n".join(lines))
    try:
        read_mapping(path)
    except (ConfigError, RunError) as error:
        assert str(error)
