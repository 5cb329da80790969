"""Names of satellites and signals, and their frequencies."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from starwise.constants import SYS_C, SYS_G, SYS_R, SYSTEMS
from starwise.errors import StarwiseError
from starwise.signals import frequency, frequency_table, signal_id, signal_name, sv_id, sv_name


@pytest.mark.laws
@given(st.sampled_from(SYSTEMS), st.integers(1, 255))
def test_satellite_names_come_back(system: str, number: int) -> None:
    assert sv_name(sv_id(f"{system}{number:02d}")) == f"{system}{number:02d}"


@pytest.mark.laws
@given(st.integers(0, 9), st.sampled_from("ABCDILMNPQSWXYZ"))
def test_signal_names_come_back(band: int, attribute: str) -> None:
    assert signal_name(signal_id(f"{band}{attribute}")) == f"{band}{attribute}"


@pytest.mark.parametrize("text", ["", "G", "X01", "G00", "G256", "G-1", "G²", "G1.", "٣", "G9999999999"])
def test_not_a_satellite(text: str) -> None:
    with pytest.raises(StarwiseError):
        sv_id(text)


@pytest.mark.parametrize("text", ["", "C", "C1C", "²I", "1é", "11"])
def test_not_a_signal(text: str) -> None:
    with pytest.raises(StarwiseError):
        signal_id(text)


@given(st.text())
def test_any_text_is_a_name_or_an_error(text: str) -> None:
    for parse in (sv_id, signal_id):
        try:
            parse(text)
        except StarwiseError as error:
            assert "\n" not in str(error)


@pytest.mark.golden
def test_frequencies() -> None:
    assert frequency(SYS_G, 1) == 1575.42e6
    assert frequency(SYS_C, 2) == 1561.098e6
    # GLONASS ICD L1/L2 5.1 table 3.1: channel -7 is 1598.0625 MHz, channel 6 is 1605.375 MHz.
    assert frequency(SYS_R, 1, -7) == 1598.0625e6
    assert frequency(SYS_R, 1, 6) == 1605.375e6
    assert frequency(SYS_R, 1) != frequency(SYS_R, 1)  # channel unknown: NaN
    assert frequency_table({sv_id("R03"): -7})[SYS_R, 3, 2] == 1242.9375e6
