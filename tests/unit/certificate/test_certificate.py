"""Certificates: what they say, in both languages; one page of PDF; signatures, also by another program."""

import re
import shutil
import subprocess
from dataclasses import replace
from datetime import date

import numpy as np
import pytest

from kreisel.calibration.data_sheet import derive
from kreisel.calibration.limits import Limits, limits_of_grade
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import EstimatorFacts, FinalNoise, Measured, Verdict
from kreisel.certificate.certificate_page import html, pdf
from kreisel.certificate.content import Certificate, certificate_of, fields_of
from kreisel.certificate.signature import new_keys, opened, sign, verify
from kreisel.certificate.words import LANGUAGES, words
from kreisel.errors import RecordingError, SettingsError
from kreisel.model.calibration_settings import ESTIMATORS
from kreisel.model.groups import REGISTRY, group_named
from kreisel.static.by_robot import METHOD
from kreisel.static.static_methods import METHODS

from ..calibration.example import calibration

TODAY = date(2026, 11, 23)


def device(**more) -> Calibration:
    own = calibration().in_axes("imu")
    assert own.recording is not None
    facts = replace(
        own.recording, digest="ab" * 32, begin_ns=1_790_000_000_000_000_000, temperature_c=24.56,
        device={"maker": "Müller & Söhne <b>", "serial_number": "0042"},
    )  # fmt: skip
    return replace(own, recording=facts, **more)


def page(language: str = "en", **fields: str) -> str:
    own = device()
    return html(certificate_of(own, fields_of(own, fields), limits_of_grade("consumer-mems"), language, TODAY))


def test_languages_have_the_same_words():
    assert words("en").keys() == words("de").keys()
    for key, text in words("en").items():
        assert re.findall(r"\{\w+", text) == re.findall(r"\{\w+", words("de")[key]), key


def test_values_are_rounded_to_two_digits_of_the_expanded_uncertainty():
    own = device()
    bias = own.derived["accel_bias_mg"]
    U = 2.0 * bias.deviation[0]
    assert 1.0 > U > 0.1  # mg: two digits after the point
    text = f"{bias.value[0]:.2f} ± {U:.2f}".replace("-", "−")
    assert text in page()
    assert text.replace(".", ",") in page("de")


def test_fields_come_from_the_recording_and_the_command_line():
    text = page(serial_number="7", operator="A. B.")
    assert "Müller &amp; Söhne &lt;b&gt;" in text
    assert ">7<" in text
    assert "0042" not in text
    assert "2026-09-21" in text  # of the first stamp
    assert "24.6 °C" in text
    assert "24,6 °C" in page("de")
    assert "does not claim traceability" in text
    assert "does not claim" not in page(traceability="PTB 1234")
    with pytest.raises(SettingsError, match="unknown field 'serial'; known are: customer, date"):
        fields_of(device(), {"serial": "1"})
    with pytest.raises(SettingsError, match="expected 1 to 200 characters"):
        fields_of(device(), {"maker": "x" * 501})


def test_stamps_that_are_no_dates_give_none():
    own = device()
    assert own.recording is not None
    early = replace(own, recording=replace(own.recording, begin_ns=1_000_000_000))
    found = dict(certificate_of(early, {}, None, "en", TODAY).facts)
    assert found["Date of calibration"] == "not stated"


def test_what_is_not_observable_has_a_mark_and_no_decision():
    own = device(verdict=Verdict(True, (), ("accelerometer.offset[1]",)))
    found = certificate_of(own, {}, limits_of_grade("consumer-mems"), "en", TODAY)
    row = next(row for row in found.axes if row.title == "Accelerometer bias")
    assert all(value.endswith("*") for value in row.values)
    assert row.decision == "no decision"
    assert words("en")["not_observable"] in found.notes


def test_effects_are_listed_with_their_uncertainties():
    found = certificate_of(device(), {}, None, "en", TODAY)
    assert [row.title for row in found.effects] == ["Gyro non-linearity"]
    assert all("±" in value for value in found.effects[0].values)


def test_effects_of_nine_numbers_take_three_rows():
    path, rng = "gyroscope.g_sensitivity", np.random.default_rng(1)
    G = Measured(1e-5 * rng.normal(size=9), np.full(9, 1e-6))
    found = certificate_of(device(others={path: G}), {}, None, "en", TODAY)
    rows = [row for row in found.effects if row.title.startswith("Gyro g-sensitivity")]
    assert [row.title for row in rows] == [f"Gyro g-sensitivity, sensor {i}" for i in "xyz"]
    size = group_named("gyro_g_sensitivity").size
    first = float(rows[1].values[0].split(" ± ")[0].replace("−", "-"))
    assert first == pytest.approx(G.value[3] / size, abs=0.06)
    held = certificate_of(device(others={path: replace(G, deviation=np.zeros(9))}), {}, None, "en", TODAY)
    assert not any(row.title.startswith("Gyro g-sensitivity") for row in held.effects)


def test_polynomials_name_their_order_and_every_group_has_words():
    own = device()
    k_w = np.vstack([own.sensors.k_w, 1e-4 * np.ones((1, 3))])
    sd = np.vstack([own.sensor_sd.k_w, 1e-5 * np.ones((1, 3))])
    more = replace(own, sensors=replace(own.sensors, k_w=k_w), sensor_sd=replace(own.sensor_sd, k_w=sd))
    titles = [row.title for row in certificate_of(more, {}, None, "de", TODAY).effects]
    assert titles == [f"Nichtlinearität der Drehratensensoren, Ordnung {order}" for order in (2, 3)]
    linear = ("gyro_cross_coupling", "gyro_offset", "accel_cross_coupling", "accel_offset", "lever_arms")
    shown = {group.name for group in REGISTRY if group.is_sensor and not group.passing and group.name not in linear}
    assert shown <= words("de").keys()


def test_the_statement_of_conformity_names_what_decides():
    def found(**limits: float) -> Certificate:
        three = {name: (value, value, value) for name, value in limits.items()}
        return certificate_of(device(), {}, Limits(three, file="own.toml"), "de", TODAY)

    bias = device().derived["accel_bias_mg"]
    edge = float(np.abs(bias.value).max())
    conforms, fails, undecided = (found(accel_bias_mg=x) for x in (10.0 * edge, 0.1 * edge, edge))
    assert conforms.conformity == words("de")["conformity_conforms"]
    assert fails.conformity.endswith("Betroffene Größen: Nullpunktabweichung der Beschleunigungssensoren.")
    assert "nicht konform" in fails.conformity
    assert "wird keine Aussage getroffen" in undecided.conformity
    assert any(note.endswith("Die Grenzwerte sind der Datei own.toml entnommen.") for note in fails.notes)
    assert fails.conformity in html(fails)
    assert certificate_of(device(), {}, None, "de", TODAY).conformity == ""


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("name", [*ESTIMATORS, *METHODS, METHOD])
def test_the_procedure_is_that_of_the_estimator(name, language):
    """Every sentence is there, none is of another estimator, and none has a place that was not filled."""
    noise = FinalNoise(1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    own = device(estimator=EstimatorFacts(name, "", 1, 0.5, 1, 1, 1.0, 1, (), noise))
    assert own.recording is not None
    static = name in METHODS
    facts = replace(own.recording, reference_poses=0 if static else 12345, reference_kind="" if static else "robot")
    made = certificate_of(replace(own, recording=facts), {}, None, language, TODAY)
    said = dict(made.facts)
    procedure = said[words(language)["procedure"]]
    assert procedure != words(language)["procedure_other"]
    assert ("Sigma" in procedure or "sigma" in procedure) == (name in ("spkf", "ukf", "cdkf", "ckf"))
    assert ("Kalman" in procedure) == (name in ("spkf", "ukf", "cdkf", "ckf", "ekf", "iekf"))
    seen = said[words(language)["reference"]]
    assert ("12\u202f345" in seen) == (not static)
    assert "{" not in html(made).split("</style>")[1]


def test_every_limit_is_shown_with_its_digits_or_refused():
    found = certificate_of(
        device(), {}, Limits({"accel_bias_mg": (1234.5678,) * 3, "gyro_bias_deg_h": (200.0,) * 3}), "de", TODAY
    )
    assert {row.limit for row in found.axes} == {"±\u00a01\u202f234,5678", "±\u00a0200", ""}
    with pytest.raises(SettingsError, match=r"limits.mounting_rotation_deg: not a property of the device"):
        certificate_of(device(), {}, Limits({"mounting_rotation_deg": (1.0,) * 3}), "en", TODAY)
    own = device()
    less = replace(own, derived={name: one for name, one in own.derived.items() if name != "accel_bias_mg"})
    with pytest.raises(SettingsError, match=r"limits.accel_bias_mg: this calibration does not have it"):
        certificate_of(less, {}, Limits({"accel_bias_mg": (1.0,) * 3}), "en", TODAY)


def test_a_rejected_result_gets_none():
    with pytest.raises(SettingsError, match="a rejected one gets no certificate"):
        certificate_of(device(verdict=Verdict(False, ("no",))), {}, None, "en", TODAY)
    with pytest.raises(SettingsError, match="unknown language 'fr'"):
        certificate_of(device(), {}, None, "fr", TODAY)


def test_the_page_needs_nothing_else():
    text = page()
    assert "default-src 'none'" in text
    assert not re.search(r"(src|href)=|url\(", text)


@pytest.mark.parametrize(
    "language", ["de", *(pytest.param(name, marks=pytest.mark.slow) for name in LANGUAGES if name != "de")]
)
def test_the_pdf_has_one_page_also_with_long_fields(language):
    pytest.importorskip("weasyprint", exc_type=OSError)
    long = dict.fromkeys(("customer", "laboratory", "operator", "place", "traceability", "remarks"), "Lorem ipsum " * 8)
    content = pdf(page(language, **long))
    assert content.startswith(b"%PDF-")
    if shutil.which("pdfinfo"):
        facts = subprocess.run(["pdfinfo", "-"], input=content, capture_output=True, check=True).stdout.decode()
        assert re.search(r"Pages:\s+1\n", facts)
        assert "A4" in facts
    if shutil.which("pdftotext"):
        text = subprocess.run(["pdftotext", "-layout", "-", "-"], input=content, capture_output=True, check=True).stdout
        assert words(language)["title"] in text.decode()
        assert "ab" * 32 in text.decode().replace("\n", "")


@pytest.mark.parametrize("language", LANGUAGES)
def test_cells_of_the_pdf_do_not_touch_and_are_on_the_page(language):
    """A cell of large numbers is its own text, and nothing is beyond the margin."""
    pytest.importorskip("weasyprint", exc_type=OSError)
    if not shutil.which("pdftotext"):
        pytest.skip("no pdftotext")
    own, grade = device(), limits_of_grade("consumer-mems")
    large = Measured(np.array([-39.6081, -123.1484, -115.7591]), np.array([0.0161, 0.0162, 0.0191]))
    made = certificate_of(replace(own, derived={**own.derived, "accel_bias_mg": large}), {}, grade, language, TODAY)
    content = pdf(html(made))
    read = ["pdftotext", "-bbox-layout", "-", "-"]
    found = subprocess.run(read, input=content, capture_output=True, check=True, text=False).stdout.decode()
    left, right = 16.0 * 72.0 / 25.4, (210.0 - 16.0) * 72.0 / 25.4
    edges = [(float(a), float(b)) for a, b in re.findall(r'<word xMin="([\d.]+)".*?xMax="([\d.]+)"', found)]
    assert len(edges) > 200
    assert min(a for a, _ in edges) > left - 1.0
    assert max(b for _, b in edges) < right + 1.0
    text = subprocess.run(["pdftotext", "-", "-"], input=content, capture_output=True, check=True).stdout.decode()
    cells = [re.sub(r"\s", " ", cell) for cell in text.splitlines()]
    for row in (*made.axes, *made.pairs):
        for cell in (*row.values, row.unit, *([row.limit] if row.limit else [])):
            assert re.sub(r"\s", " ", cell) in cells, row.title


def test_signatures(tmp_path):
    secret, public = new_keys(tmp_path / "lab", "abc")
    assert secret.stat().st_mode & 0o077 == 0
    file = tmp_path / "c.pdf"
    file.write_bytes(b"a certificate")
    sign(file, opened(secret, "abc"), "c.pdf of\n2026")
    assert verify(file, public) == "c.pdf of 2026"
    other = new_keys(tmp_path / "other", None)[1]
    with pytest.raises(RecordingError, match="the signature is wrong"):
        verify(file, other)
    file.write_bytes(b"another one")
    with pytest.raises(RecordingError, match="the signature is wrong"):
        verify(file, public)
    with pytest.raises(RecordingError, match="cannot sign with it"):
        sign(file, opened(secret, "wrong"), "")
    with pytest.raises(RecordingError, match="cannot sign with it"):
        opened(secret, "wrong")
    with pytest.raises(RecordingError, match="is encrypted"):
        sign(file, opened(secret, None), "")
    with pytest.raises(RecordingError, match=r"lab\.pub: not a secret key of minisign"):
        sign(file, opened(public, None), "")
    with pytest.raises(RecordingError, match=r"lab\.key: not a public key of minisign"):
        verify(file, secret)
    (tmp_path / "c.pdf.minisig").write_text("nothing")
    with pytest.raises(RecordingError, match=r"c\.pdf\.minisig: not a signature of minisign"):
        verify(file, public)
    (tmp_path / "c.pdf.minisig").unlink()
    with pytest.raises(RecordingError, match=r"c\.pdf\.minisig: no such file"):
        verify(file, public)
    with pytest.raises(RecordingError, match="exists already"):
        new_keys(tmp_path / "lab", None)


def test_the_program_minisign_verifies_them(tmp_path):
    program = shutil.which("minisign")
    if program is None:
        pytest.skip("no minisign")
    secret, public = new_keys(tmp_path / "lab", None)
    file = tmp_path / "c.pdf"
    file.write_bytes(b"a certificate")
    sign(file, opened(secret, None), "hello")
    done = subprocess.run([program, "-V", "-p", public, "-m", file], capture_output=True, text=True, check=True)
    assert "hello" in done.stdout


def test_the_example_has_derived_quantities():
    own = calibration().in_axes("imu")
    again = derive(own.sensors, np.zeros((33, 33)), lambda change: own.sensors)
    np.testing.assert_allclose(own.derived["accel_bias_mg"].value, again["accel_bias_mg"].value)
