"""Configuration: defaults, TOML, options, and every way to get it wrong."""

from pathlib import Path

import pytest

from starwise.config import ClockNoise, ProcessNoise, RunConfig, load_config
from starwise.errors import StarwiseError


def test_effective_configuration_round_trips() -> None:
    config = RunConfig(
        method="lsq", mask_deg=5, signals={"G": ("1C", "2W")}, exclude=("G05",), process=ProcessNoise(model="singer")
    )
    assert RunConfig.from_dict(config.to_dict()) == config
    assert config.mask_deg == 5.0
    assert isinstance(config.mask_deg, float)


def test_file_and_options(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text(
        'method = "ekf"\nmask_deg = 7\nexclude = ["R04"]\nstart = 2024-01-01T12:00:00\n'
        '[process]\nmodel = "singer"\nacceleration_tau_s = 20\n[signals]\nE = ["1X"]\n'
    )
    config = load_config(path, {"mask_deg": 12, "process.model": "velocity", "clock.bias_psd_m2_per_s": 2})
    assert config.method == "ekf"
    assert config.mask_deg == 12.0
    assert config.process == ProcessNoise(model="velocity", acceleration_tau_s=20.0)
    assert config.clock == ClockNoise(bias_psd_m2_per_s=2.0)
    assert config.signals == {"E": ("1X",)}
    assert config.start_ns is not None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("methd = 'lsq'", ["run.toml:1", "methd", "'method'?"]),
        ("mask_deg = 5\n[process]\nacceleration_tau = 3", ["run.toml:3", "'process.acceleration_tau_s'?"]),
        ("method = 'kalman'", ["run.toml:1", "'method'", "kalman", "lsq | ekf | s3ekf"]),
        ("mask_deg = 95", ["'mask_deg'", "95", "-5 to 90"]),
        ("mask_deg = true", ["'mask_deg'", "number"]),
        ("mask_deg = nan", ["'mask_deg'", "finite"]),
        ("mask_deg = '5'", ["'mask_deg'", "number"]),
        ("gate_probability = 0", ["'gate_probability'", "above 0"]),
        ("fde = 1", ["'fde'", "true or false"]),
        ("exclude = 'G05'", ["'exclude'", "list"]),
        ("exclude = ['Q1']", ["satellite", "Q1"]),
        ("systems = 'GXR'", ["systems", "GXR"]),
        ("systems = 'GG'", ["systems", "GG"]),
        ("signals = 3", ["'signals'", "table"]),
        ("[signals]\nG = ['C1C']", ["signal", "C1C"]),
        ("start = 'noon'", ["time", "noon"]),
        ("start = '2024-01-02T00:00:00'\nend = '2024-01-01T00:00:00'", ["before start"]),
        ("process = 3", ["'process'", "table"]),
        ("interval_s = 0", ["'interval_s'", "0.01"]),
        ("= 3", ["not TOML", "run.toml:1"]),
    ],
)
def test_refused_in_one_line(tmp_path: Path, text: str, words: list[str]) -> None:
    path = tmp_path / "run.toml"
    path.write_text(text)
    with pytest.raises(StarwiseError) as caught:
        load_config(path)
    message = str(caught.value)
    assert "\n" not in message
    assert "run.toml" in message
    for word in words:
        assert word in message


def test_option_that_is_not_known() -> None:
    with pytest.raises(StarwiseError, match="'mask_deg'"):
        load_config(None, {"mask": 3})
    with pytest.raises(StarwiseError):
        RunConfig(mask_deg="high")  # type: ignore[arg-type]


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(StarwiseError, match=r"nowhere\.toml: cannot be read"):
        load_config(tmp_path / "nowhere.toml")
