"""Options files of RTKLIB: equivalents, what is named, what passes in silence, what is refused."""

import json
import random
from pathlib import Path

import pytest

from starwise.cli import run
from starwise.config import RunConfig, load_config
from starwise.errors import StarwiseError
from starwise.io.rtklib_conf import options_of, read_rtklib_conf
from test_edge_mutations import mutated

SPP = """# rtkpost options (2022/01/01 00:00:00, v.2.4.3 b34)

pos1-posmode       =single     # (0:single,1:dgps,2:kinematic,3:static,4:movingbase,5:fixed,6:ppp-kine)
pos1-frequency     =l1+l2      # (1:l1,2:l1+l2,3:l1+l2+l5)
pos1-soltype       =forward    # (0:forward,1:backward,2:combined)
pos1-elmask        =15         # (deg)
pos1-snrmask_r     =off        # (0:off,1:on)
pos1-snrmask_L1    =0,0,0,0,0,0,0,0,0
pos1-dynamics      =off        # (0:off,1:on)
pos1-tidecorr      =off
pos1-ionoopt       =brdc
pos1-tropopt       =saas
pos1-sateph        =brdc
pos1-posopt1       =off
pos1-posopt5       =on
pos1-exclsats      =           # (prn ...)
pos1-navsys        =1          # (1:gps+2:sbas+4:glo+8:gal+16:qzs+32:comp)
pos2-armode        =continuous
pos2-rejionno      =30         # (m)
out-solformat      =llh
out-height         =ellipsoidal
stats-eratio1      =100
stats-errphase     =0.003      # (m)
ant1-postype       =llh
ant1-pos1          =90         # (deg|m)
misc-timeinterp    =off
file-satantfile    =
"""


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "x.conf"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_file_of_rtkpost(tmp_path: Path) -> None:
    imported = read_rtklib_conf(written(tmp_path, SPP))
    assert imported.notes == []
    assert load_config(None, imported.options) == RunConfig(
        method="lsq", error_model="white", combination="single", mask_deg=15.0, ionosphere="broadcast",
        troposphere="saastamoinen", systems="G", fde=True,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("lines", "options"),
    [
        ("pos1-ionoopt=off", {"ionosphere": "none"}),
        ("pos1-ionoopt=0", {"ionosphere": "none"}),
        ("pos1-ionoopt=dual-freq", {"combination": "ionosphere_free"}),
        ("pos1-ionoopt=3\npos1-frequency=2", {"combination": "ionosphere_free"}),
        ("pos1-tropopt=off", {"troposphere": "none"}),
        ("pos1-tropopt=est-ztd", {"troposphere": "saastamoinen"}),
        ("pos1-elmask=7.5", {"mask_deg": 7.5}),
        ("pos1-navsys=61", {"systems": "GRECJ"}),
        ("pos1-navsys=0x29", {"systems": "GEC"}),
        ("pos1-exclsats=G05 R12 C59", {"exclude": ["G05", "R12", "C59"]}),
        ("pos1-exclsats=5 193", {"exclude": ["G05", "J01"]}),
        ("pos1-posopt5=off", {"fde": False}),
        ("pos1-snrmask_r=on\npos1-snrmask_L1=33,33,33,33,33,33,33,33,33", {"cn0_min_dbhz": 33.0}),
        ("pos1-elmask=7\npos1-elmask=9", {"mask_deg": 9.0}),  # the last one counts, as in RTKLIB
    ],
)
def test_equivalents(lines: str, options: dict[str, object], tmp_path: Path) -> None:
    imported = read_rtklib_conf(written(tmp_path, lines))
    assert {key: imported.options[key] for key in options} == options
    assert imported.notes == []
    load_config(None, imported.options)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("pos1-ionoopt=ionex-tec", "pos1-ionoopt = ionex-tec: not here; the broadcast model"),
        ("pos1-tropopt=sbas", "pos1-tropopt = sbas: not here; Saastamoinen"),
        ("pos1-sateph=brdc+ssrapc", "pos1-sateph = brdc+ssrapc: corrections are not here"),
        ("pos1-navsys=71", "pos1-navsys = 71: SBAS and NavIC not positioned with"),
        ("pos1-exclsats=+G05", "pos1-exclsats = +G05: G05 not used while marked unhealthy"),
        ("pos1-soltype=combined", "pos1-soltype = combined: filters run forward only"),
        ("pos1-snrmask_r=on\npos1-snrmask_L1=40,38,36,35,34,33,32,31,30", "no limits by elevation; 30 dB-Hz"),
        ("pos2-rejgdop=30", "pos2-rejgdop = 30: no epoch is left out"),
        ("out-height=geodetic", "out-height = geodetic: heights stay ellipsoidal"),
        ("out-timesys=utc", "out-timesys = utc: times stay GPST"),
        ("out-maxsolstd=2", "out-maxsolstd = 2: no epoch is left out"),
        ("stats-errphase=0.01\nstats-eratio1=300", "stats-eratio1, stats-errphase: not taken"),
        ("misc-rnxopt1=-GL1W", "misc-rnxopt1 = -GL1W: not read"),
        ("file-dcbfile=a.dcb", "file-dcbfile = a.dcb: not read"),
        (
            "inpstr1-type=serial\ninpstr1-path=x\nlogstr1-type=off",
            "inpstr1-type and 2 more: keys of RTKLIB's real-time",
        ),
        ("pos1-sateph=precise\nfile-satantfile=igs20.atx", "file-satantfile = igs20.atx: phase centres of satellites"),
        (
            "pos1-ionoopt=dual-freq\npos1-snrmask_r=on\npos1-snrmask_L1=30,30,30,30,30,30,30,30,30\n"
            "pos1-snrmask_L2=20,20,20,20,20,20,20,20,20",
            "pos1-snrmask_L2 = 20,20,20,20,20,20,20,20,20: not taken",
        ),
        ("pos1-fancy=on", "pos1-fancy: not known here, not taken"),
    ],
)
def test_what_has_no_equivalent_is_named(line: str, words: str, tmp_path: Path) -> None:
    imported = read_rtklib_conf(written(tmp_path, f"pos1-posmode=single\n{line}\n"))
    assert len(imported.notes) == 1
    assert words in imported.notes[0]
    load_config(None, imported.options)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "x.conf: the file is empty"),
        ("hello\n", "x.conf:1: not an option"),
        ("a=b\n", "not an options file"),
        ("\x00\x01\x02=\n", "x.conf:1"),
        (
            "pos1-posmode=kinematic\n",
            "x.conf:1: pos1-posmode = kinematic: positioning against a base is not in starwise",
        ),
        ("pos1-posmode=7\n", "pos1-posmode = ppp-static: carrier-phase"),
        ("pos1-posmode=best\n", "pos1-posmode is not readable; found 'best'; wanted single, dgps"),
        ("pos1-elmask=x\n", "pos1-elmask is not readable"),
        ("pos1-ionoopt=klobuchar\n", "pos1-ionoopt is not readable"),
        ("pos1-frequency=l7\n", "pos1-frequency is not readable"),
        ("pos1-navsys=gps\n", "pos1-navsys is not readable"),
        ("pos1-navsys=2\n", "pos1-navsys is not readable"),
        ("pos1-exclsats=G99x\n", "pos1-exclsats is not readable"),
        ("pos1-snrmask_r=on\npos1-snrmask_L1=a\n", "x.conf:2: pos1-snrmask_L1"),
    ],
)
def test_refused_in_one_line(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(StarwiseError) as caught:
        read_rtklib_conf(written(tmp_path, text))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_command_line_overrides(tmp_path: Path) -> None:
    path = written(tmp_path, SPP.replace("single ", "static ").replace("brdc\npos1-tropopt       =saas", "est-stec"))
    with pytest.raises(StarwiseError, match="--method s3ekf"):
        options_of(path, {}, {}, [])
    options, notes = options_of(path, {"method": "s3ekf", "mask_deg": 5.0}, {}, [])
    config = load_config(None, options)
    assert (config.method, config.mask_deg, config.dynamics) == ("s3ekf", 5.0, "static")
    assert (config.error_model, config.combination) == ("colored", "auto")  # a filter has states for what lasts
    assert len(notes) == 2
    assert "pos1-posmode = static" in notes[1]
    with pytest.raises(StarwiseError, match="--config"):
        options_of(path, {}, {"--config": "x.toml"}, [])


def test_mutations(tmp_path: Path) -> None:
    rng = random.Random(3)
    refused = 0
    for _ in range(400):
        path = written(tmp_path, mutated(SPP.encode(), rng) or b" ")
        try:
            load_config(None, read_rtklib_conf(path).options)
        except StarwiseError as error:
            refused += 1
            assert "\n" not in str(error)
    assert 20 < refused < 400


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("spp", {"systems": "GRECJ", "method": "lsq"}),
        ("spp_ge", {"systems": "GE", "method": "lsq"}),
        ("spp_gec", {"systems": "GEC", "method": "lsq"}),
        ("spp_gps", {"systems": "G", "method": "lsq"}),
        ("ppp_kine", {"combination": "ionosphere_free"}),
        ("ppp_static", {"combination": "ionosphere_free", "dynamics": "static"}),
        ("rtk_kine", {"mask_deg": 15.0, "combination": "auto"}),
        ("rtk_kine_l1", {"mask_deg": 15.0, "combination": "single"}),
        ("rtk_static", {"mask_deg": 15.0, "dynamics": "static"}),
    ],
)
def test_shared_files(name: str, wanted: dict[str, object], shared_data: Path) -> None:
    path = shared_data / "rtklib_conf" / f"{name}.conf"
    if name.startswith("spp"):
        options, notes = options_of(path, {}, {}, [])
        assert len(notes) == 1  # only where the options are from: nothing in these files is without an equivalent
    else:
        with pytest.raises(StarwiseError, match="is not in starwise"):
            options_of(path, {}, {}, [])
        options, notes = options_of(path, {"method": "s3ekf"}, {}, [])
        assert "positioned by code and Doppler" in notes[1]
        assert any("no SP3 file is given" in note for note in notes) == name.startswith("ppp")
    config = load_config(None, options)
    assert {key: getattr(config, key) for key in wanted} == wanted
    assert {path.stem for path in path.parent.glob("*.conf")} == {
        "spp", "spp_ge", "spp_gec", "spp_gps", "ppp_kine", "ppp_static", "rtk_kine", "rtk_kine_l1", "rtk_static",
    }  # fmt: skip


@pytest.mark.real
def test_solve_as_rtklib_does(shared_data: Path, tmp_path: Path) -> None:
    """The same options on the same ten minutes: positions of RTKLIB's size, the notes in run.json."""
    source = shared_data / "static" / "kiru_2024090"
    files = [next(source.glob(pattern)) for pattern in ("KIRU00SWE_R_*_MO.rnx", "KIR000SWE_R_*_MN.rnx")]
    conf = shared_data / "rtklib_conf" / "spp_ge.conf"
    window = ["--start", "2024-03-30T00:30:00", "--end", "2024-03-30T00:40:00"]
    arguments = ["solve", *map(str, files), "--rtklib-conf", str(conf), *window, "-o", str(tmp_path / "out"), "-q"]
    assert run(arguments) == 0
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert record["config"]["method"] == "lsq"
    assert record["config"]["systems"] == "GE"
    assert "spp_ge.conf" in record["notes"][0]
