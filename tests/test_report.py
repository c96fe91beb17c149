"""The report page: complete, self-contained, reproducible, harmless."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.figure import Figure

from jaxid.base import wording
from jaxid.diagnosis import reasons
from jaxid.diagnosis.result import HowFar
from jaxid.fitting.result import Estimate
from jaxid.fitting.stated import StatedNumber
from jaxid.report import carry, diagnosis_fragment, diagnosis_page, plot, text
from jaxid.report.answer import short
from jaxid.report.carry import values_to_write
from jaxid.report.display import write
from jaxid.report.identified import base_rows
from jaxid.report.missing_force import draw_spectrum, spectrum
from jaxid.report.text import parameter_rows
from jaxid.robots.contacts import NOT_SIMULATED
from jaxid.robots.export.target import ExportRow
from jaxid.study.page import _counted as counted
from page_samples import identification, RESULTS, robot_under_goals
from report_sample import hostile, sample_diagnosis, sample_fit, sample_simulation


class Page(HTMLParser):
    """Elements and attributes as a browser sees them."""

    def __init__(self, source: str):
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(source)
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.words.append(data)


def assert_harmless(source: str) -> Page:
    page = Page(source)
    tags = {tag for tag, _ in page.elements}
    assert not tags & {
        "script",
        "iframe",
        "object",
        "embed",
        "link",
        "img",
        "form",
        "base",
        "foreignobject",
    }
    for tag, attributes in page.elements:
        for name, value in attributes.items():
            assert not name.startswith("on"), (tag, name)
            if name in ("href", "xlink:href", "src"):
                assert (value or "").startswith("#"), (tag, value)
    assert "@import" not in source
    assert not any(c in source for c in "\x1b\u202e\x00")
    return page


def test_diagnosis_page(tmp_path):
    path = sample_diagnosis(36000).report(tmp_path / "sub" / "report.html")
    source = path.read_text(encoding="utf-8")
    assert len(source) < 2e6
    page = assert_harmless(source)
    for words in (
        "The model lacks coulomb friction at q",
        "level 0.1123 ± 0.0016 N m",
        "99.8 % of the gap closed",
        "99.2 % to 99.93 %",
        "stribeck_friction at q",
        "Record slow motion",
        "velocity (rad/s)",
        "measured − model",
        "not determined by these data",
        "at its bound",
        "Without repeats the noise is the sensor's alone.",
    ):
        assert words in page.text, words
    assert [tag for tag, _ in page.elements].count("figure") == 6
    assert list(path.parent.iterdir()) == [path]  # no partial file is left


def test_pages_are_reproducible(tmp_path):
    first = write(sample_diagnosis(), tmp_path / "a.html").read_bytes()
    assert write(sample_diagnosis(), tmp_path / "b.html").read_bytes() == first


def test_fit_page(tmp_path):
    page = assert_harmless(write(sample_fit(), tmp_path / "fit.html").read_text(encoding="utf-8"))
    assert "q is reproduced to 0.000440 rad rms on validation data." in page.text
    assert "0.08123 ± 0.00042" in page.text


def test_failed_fit_page(tmp_path):
    failed = replace(
        sample_fit(),
        failed=True,
        converged=False,
        stopped_because="every start diverged",
        loss=float("nan"),
        scores={},
        traces=(),
        history=(),
        parameters={},
        correlated=(),
    )
    page = assert_harmless(write(failed, tmp_path / "fit.html").read_text(encoding="utf-8"))
    assert "The fit failed: every start diverged." in page.text


@pytest.mark.parametrize("verdict", ["named", "partly", "none", "unknown"])
def test_every_verdict(tmp_path, verdict):
    d = sample_diagnosis()
    if verdict in ("none", "unknown"):
        far = HowFar(
            12.0,
            11.0,
            11.0,
            1.0,
            None,
            None,
            "fewer than 8 independent blocks",
            d.how_far.per_channel,
        )
        d = replace(
            d, which=replace(d.which, verdict=verdict, effects=(), confusable_with=()), how_far=far
        )
    else:
        d = replace(d, which=replace(d.which, verdict=verdict))
    page = assert_harmless(d.report(tmp_path / "r.html").read_text(encoding="utf-8"))
    assert {
        "named": "The model lacks",
        "partly": "something more that no known effect explains",
        "none": "Nothing is missing",
        "unknown": "no known effect explains",
    }[verdict] in page.text
    lines = text.diagnosis_text(d).splitlines()
    assert 4 <= len(lines) <= 16
    assert ("WHERE" in text.diagnosis_text(d)) == (verdict != "none")


def test_where_nothing_is_missing_the_numbers_are_said_with_their_deviations():
    d = sample_diagnosis()
    d = replace(d, which=replace(d.which, verdict="none", effects=(), confusable_with=()))
    estimate = d.final.parameters["inertia"]
    said = text.diagnosis_text(replace(d, final=replace(d.final, stated=())))
    assert f"NUMBERS   inertia {text.value_with_std(estimate)}" in said
    assert "NUMBERS" not in text.diagnosis_text(sample_diagnosis())


def test_empty_diagnosis(tmp_path):
    """Nothing to draw is no error."""
    d = sample_diagnosis()
    d = replace(
        d,
        traces=(),
        missing_force=(),
        regimes=(),
        where=(),
        notes=(),
        which=replace(d.which, ranking=()),
    )
    assert_harmless(d.report(tmp_path / "r.html").read_text(encoding="utf-8"))


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 1e300])
def test_numbers_that_are_hard_to_draw(tmp_path, value):
    d = sample_diagnosis()
    far = replace(d.how_far, gap_before=value, gap_after=value, gap_retuned=value)
    ranking = tuple(
        replace(r, validation_gap=value, evidence=value, bic=value) for r in d.which.ranking
    )
    traces = tuple(
        replace(
            t, simulated={k: np.full_like(s, value) for k, s in t.simulated.items()}, noise=value
        )
        for t in d.traces
    )
    forces = tuple(
        replace(m, before=np.full_like(m.before, value), floor=np.full_like(m.floor, value))
        for m in d.missing_force
    )
    regimes = tuple(replace(r, ratio=value) for r in d.regimes)
    which = replace(d.which, ranking=ranking)
    d = replace(d, how_far=far, traces=traces, missing_force=forces, regimes=regimes, which=which)
    assert_harmless(d.report(tmp_path / "r.html").read_text(encoding="utf-8"))


def test_hostile_names_are_text(tmp_path):
    source = hostile(sample_diagnosis()).report(tmp_path / "r.html").read_text(encoding="utf-8")
    page = assert_harmless(source)
    assert "<script>alert(1)</script>$\\frac{1$" in page.text
    assert "\x1b" not in text.diagnosis_text(hostile(sample_diagnosis()))


def test_fragment_for_notebooks():
    html = sample_diagnosis()._repr_html_()
    assert html == diagnosis_fragment(sample_diagnosis())
    assert_harmless(html)
    assert "<html" not in html and "coulomb friction at q" in html


def test_drawing_leaves_matplotlib_alone():
    import sys

    import matplotlib

    def settings():  # asking for the backend would load pyplot to choose one
        return {
            name: repr(matplotlib.rcParams[name])
            for name in matplotlib.rcParams
            if not name.startswith("backend")
        }

    before, had_pyplot = settings(), "matplotlib.pyplot" in sys.modules
    diagnosis_fragment(sample_diagnosis())
    assert settings() == before
    assert ("matplotlib.pyplot" in sys.modules) == had_pyplot


def test_thinning_keeps_extremes():
    t = np.arange(36000.0)
    y = np.zeros(36000)
    y[12345], y[20001], y[30000] = 7.0, -9.0, np.nan
    thin_t, thin_y = plot.thin(t, y)
    assert len(thin_t) <= plot.POINTS and np.all(np.diff(thin_t) > 0)
    assert np.nanmax(thin_y) == 7.0 and np.nanmin(thin_y) == -9.0
    assert plot.thin(t[:100], y[:100])[0] is not None


def test_spectrum_of_white_noise_is_its_density():
    rng = np.random.default_rng(0)
    frequency, density = spectrum(np.arange(40000) * 1e-3, 0.5 * rng.standard_normal(40000))
    # One-sided: variance 0.25 spread evenly up to 500 Hz.
    assert np.sqrt(np.mean(density[20:] ** 2)) == pytest.approx(np.sqrt(0.25 / 500), rel=0.05)


@pytest.mark.parametrize(
    ("value", "std", "expected"),
    [
        (0.08123, 0.00042, "0.08123 ± 0.00042"),
        (203.5, 3.4, "203.5 ± 3.4"),
        (2.1e11, 3e9, "2.100e+11 ± 3.0e+09"),
        (1.0, None, "1.00"),
        (1.0, float("nan"), "1.00"),
        (0.0, 0.1, "0.00 ± 0.10"),
    ],
)
def test_value_with_std(value, std, expected):
    assert text.value_with_std(Estimate(value, std, "", 0.0, 1.0)) == expected
    assert (
        text.value_with_std(Estimate(value, std, "1", 0.0, 1.0)) == expected
    )  # a share of 0.08 is no "0.08 1"
    assert text.value_with_std(Estimate(value, std, "N m", 0.0, 1.0)) == f"{expected} N m"


@pytest.mark.parametrize(
    ("fraction", "expected"),
    [
        (0.998, "99.8 %"),
        (0.9998, "99.98 %"),
        (0.62, "62 %"),
        (0.0011, "0.1 %"),
        (0.0, "0 %"),
        (1.0, "100 %"),
        (0.9999999, "over 99.99 %"),
        (1.0000001, "100 %"),
        (-0.2, "-20 %"),
    ],
)
def test_percent(fraction, expected):
    assert wording.percent(fraction) == expected


# ---- objects in a notebook


def sample_dataset():
    import jaxid

    rng = np.random.default_rng(0)
    t = np.arange(200) / 100
    bad = "<script>alert(1)</script>"
    return jaxid.Dataset.from_arrays(
        [t, t],
        {"tau": [np.sin(t), np.cos(t)]},
        {"q": [rng.standard_normal(200), rng.standard_normal(200)]},
        name="arm",
        description=bad,
        noise_std={"q": 1e-3},
        check_model=False,
    )


def test_datasets_and_fits_show_themselves_short_and_escaped():
    source = sample_dataset()._repr_html_()
    page = assert_harmless(source)
    assert (
        "<script>alert(1)</script>" in page.text
        and "200 samples, 1.99 s" in page.text
        and "noise 0.0010 rad" in page.text
    )
    source = sample_fit()._repr_html_()
    page = assert_harmless(source)
    assert "0.08123 ± 0.00042" in page.text and "<svg" not in source and len(source) < 12_000
    assert_harmless(hostile(sample_diagnosis()).final._repr_html_())
    page = assert_harmless(hostile(sample_diagnosis())._repr_html_())
    assert "<script>alert(1)</script>" in page.text


def test_what_the_prompt_shows_is_short_and_plain():
    """`repr` of what a user holds: a few lines, names from files without control characters."""
    strange = hostile(sample_diagnosis())
    data = replace(sample_dataset(), name="arm\x1b]0;x\x07\u202e")
    for result, longest in (
        (data, 1),
        (strange, 20),
        (strange.final, 30),
        (sample_simulation(), 8),
    ):
        words = repr(result)
        assert 1 <= len(words.splitlines()) <= longest and len(words) < 3000, type(result)
        assert not any(c in words for c in "\x1b\x07\x00\u202e"), type(result)
        assert not words.startswith(type(result).__name__ + "("), "every field of a dataclass"


def plots():
    from jaxid.fitting.profiles import Profile

    d = sample_diagnosis(1500)
    curve = Profile(
        "coulomb",
        np.linspace(0, 1, 7),
        np.linspace(-2, 2, 7) ** 2,
        3.84,
        (0.1, None),
        (False, True),
    )
    return {
        "dataset": sample_dataset().plot,
        "fit": d.nominal.plot,
        "trace": d.traces[-1].plot,
        "diagnosis": d.plot,
        "missing force": d.missing_force[0].plot,
        "profile": curve.plot,
    }


@pytest.mark.parametrize("name", list(plots()))
def test_plots_take_axes_return_them_and_do_not_show(name, monkeypatch):
    from matplotlib import pyplot
    from matplotlib.figure import Figure

    monkeypatch.setattr(pyplot, "show", lambda *a, **k: pytest.fail("shown"))
    pyplot.switch_backend("Agg")
    given = Figure().add_subplot()
    assert plots()[name](ax=given) is given
    assert given.get_xlabel() and (given.get_ylabel() or name == "diagnosis")
    own = plots()[name]()
    assert own.figure is not given.figure
    own.figure.canvas.draw()
    if (key := own.get_legend()) is not None:  # above the axes: it covers no data
        assert key.get_window_extent().y0 >= own.get_window_extent().y1 - 2
    pyplot.close("all")


def test_a_plot_of_what_is_not_there_is_refused():
    with pytest.raises(ValueError, match="did you mean 'tau'"):
        sample_dataset().plot("taau")


def test_nothing_calls_show():
    from pathlib import Path

    root = Path(__file__).parents[1]
    for folder in ("jaxid", "models", "fitters", "notebooks", "docs"):
        for file in (root / folder).rglob("*.py"):
            assert "plt.show" not in file.read_text() and "pyplot.show" not in file.read_text(), (
                file
            )


def test_candidates_are_drawn_beside_what_they_were_tried_beside():
    from jaxid.diagnosis.result import Ranked
    from jaxid.report.ranking import rounds

    tried = [((), 4), (("a at q",), 3), (("b at q",), 1), (("c at q", "a at q"), 1)]
    rows = [
        (Ranked(f"e{k}", "q", 1.0, 1.0, 1.0, "", beside), "")
        for beside, n in tried
        for k in range(n)
    ]
    assert {beside: len(own) for beside, own in rounds(rows).items()} == {(): 4, ("a at q",): 3}
    named = [*rows[:-1], (rows[-1][0], "named")]
    assert list(rounds(named)) == [(), ("a at q",), ("a at q", "c at q")]


def test_numbers_known_only_together_are_said_once():
    fit = replace(sample_fit(), correlated=tuple((f"a{k}", f"b{k}") for k in range(9)))
    told = text.together(fit)
    assert told.count("not one by one") == 1 and "; and 3 more groups" in told
    assert text.together(replace(fit, correlated=())) == ""


def test_stated_numbers_stand_beside_those_of_the_fit(tmp_path):
    from jaxid.fitting.stated import StatedNumber

    stated = (
        StatedNumber("q", "", "inertia", 0.0777, 0.08123, 0.0004, 8.0, "inertia: …", "kg m^2"),
    )
    page = write(replace(sample_fit(), stated=stated), tmp_path / "fit.html").read_text(
        encoding="utf-8"
    )
    assert '<th scope="col" class="n">stated</th>' in page and ">0.0777<" in page
    assert '<th class="n">stated</th>' not in write(sample_fit(), tmp_path / "b.html").read_text(
        encoding="utf-8"
    )


def contrast(color: str) -> float:
    """That of a colour to white (WCAG 2.2)."""
    parts = np.array([int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(1.05 / (linear @ [0.2126, 0.7152, 0.0722] + 0.05))


def test_what_is_drawn_stands_out_from_the_page():
    names = ("ORANGE", "SKY", "GREEN", "BLUE", "VERMILLION", "PURPLE", "GREY", "BLACK")
    assert {n: c for n in names if (c := contrast(getattr(plot, n))) < 3.0} == {}


def test_every_picture_stands_once_and_says_what_it_shows(tmp_path):
    source = sample_diagnosis().report(tmp_path / "page.html").read_text(encoding="utf-8")
    page = Page(source)
    tags = [tag for tag, _ in page.elements]
    pictures = [attributes for tag, attributes in page.elements if tag == "svg"]
    assert len(pictures) == tags.count("figure")
    assert all(p["role"] == "img" and p["aria-label"] for p in pictures)
    assert tags.count("desc") == len(pictures)
    assert "q (rad); measured − model (rad) over time (s)" in page.text
    assert "Shown: measured, nominal model, with coulomb_friction at q" in page.text


def test_tables_have_captions_and_their_heads_a_scope(tmp_path):
    source = sample_diagnosis().report(tmp_path / "page.html").read_text(encoding="utf-8")
    tags = [tag for tag, _ in Page(source).elements]
    assert tags.count("caption") == tags.count("table") > 3
    heads = [attributes for tag, attributes in Page(source).elements if tag == "th"]
    assert {h.get("scope") for h in heads} == {"col", "row"}


def test_a_page_has_its_contents_and_a_notebook_has_none(tmp_path):
    source = sample_diagnosis().report(tmp_path / "page.html").read_text(encoding="utf-8")
    links = [a["href"] for tag, a in Page(source).elements if tag == "a"]
    places = [a["id"] for tag, a in Page(source).elements if tag == "h2"]
    assert links == [f"#{place}" for place in places] and len(set(links)) == len(links) > 3
    assert "<nav" not in sample_diagnosis()._repr_html_()


def test_a_card_has_room_for_sixty_words():
    sentence = " ".join(["word"] * 25) + "."
    card = short("A fact", [sentence, sentence, sentence])
    assert card == (("A fact", [sentence, sentence]), [sentence])
    assert short("A fact", [" ".join(["long"] * 90)]).more == []
    several = " ".join([f"A{sentence}"] * 3)  # one string, three sentences
    assert short("A fact", [several]) == (("A fact", [f"A{sentence}"] * 2), [f"A{sentence}"])


def test_no_reason_is_a_sentence_that_fills_a_card():
    """What a verdict rests on stands on a card, sentence by sentence: one always does."""
    kinds = [kind for kind in vars(reasons).values() if isinstance(kind, type)]
    forms = {kind.__name__: getattr(kind, "form", "") for kind in kinds}
    assert len(forms) > 20
    for name, form in forms.items():
        longest = max(len(part.split()) for part in re.split(r"(?<=[.!?]) (?=[A-Z])", form))
        assert longest <= 40, name


def test_a_robots_joints_stand_in_one_table():
    """Each joint's errors once, with its noise; what to write behind the cards."""
    page = diagnosis_page(robot_under_goals())
    assert page.count(">0.0310 rad<") == 1 and "0.000400 rad (sensor)" in page
    assert "rms error, as stated" not in page
    assert page.index("What to do</h2>") < page.index("joint by joint</h2>")


def test_what_to_write_is_a_line_a_number_and_what_is_said_of_it_once():
    said = "a URDF has no field for it: set it in the simulator"
    rows = [
        ExportRow("armature", f"j{k}", "", 0.1 * k, "kg m^2", "none", f"{said}; before: 0.01")
        for k in range(5)
    ]
    law = {"sine": 0.9641, "order": 1.0}
    rows.append(ExportRow("position_dependent_friction", "j1", "", law, "N m", "code", ""))
    lines = [carry.change(row) for row in rows]
    assert [line.before for line in lines] == ["0.01"] * 5 + [""]
    assert lines[-1].value == "sine\u00a00.9641, order\u00a01.000\u00a0N\u00a0m"
    assert carry.remarks(rows) == [f"armature at 5 places: {said}."]


def test_numbers_that_none_stated_are_no_step_of_the_budget():
    """Re-tuned numbers close nothing where nothing is stated: one bar, one number in a sentence."""
    plain = sample_diagnosis()
    far = replace(plain.how_far, gap_before=8.84, gap_retuned=8.84)
    page = diagnosis_page(replace(plain, how_far=far))
    assert "Shown: numbers re-tuned, with the missing effect" in page
    assert "closes 0 %" not in page and ">as stated</text>" not in page
    assert "re-tuned alone" not in page and "falls from 8.8 to 1.08 times" in page
    assert "Shown: as stated, numbers re-tuned, with" in diagnosis_page(plain)


def test_a_number_that_is_not_determined_is_not_far_from_what_is_stated():
    found = identification()
    row = {"parameter": found.names[3], "stated": 0.1, "deviation": 6.8}
    sure = {"parameter": found.names[0], "stated": 0.1, "deviation": 5.2}
    rows = base_rows(replace(found, stated=(row, sure)))
    assert rows[3][3] == "" and rows[3][-1] == "not determined" and rows[0][3] == "+5.2"


@pytest.mark.parametrize("kind", RESULTS)
def test_contents_stand_below_the_answer(kind, tmp_path):
    """Behind the first part of a page, however its sections are cut, and in no part of its own."""
    source = write(RESULTS[kind](), tmp_path / "page.html").read_text(encoding="utf-8")
    if "<nav" not in source:
        return
    place = source.index("<nav")
    assert source.index("<h1") < place < source.index("<h2", source.index("<h1"))


@pytest.mark.parametrize("verdict", ["named", "partly", "none", "unknown"])
def test_values_are_to_be_written_unless_nothing_is_known(verdict):
    """A number that was re-tuned under a gap that nothing explains is not one to write."""
    diagnosis = sample_diagnosis()
    refuted = StatedNumber(
        joint="",
        link="",
        parameter="inertia",
        stated=0.058,
        fitted=0.052,
        std=0.001,
        deviation=-6.0,
        text="inertia is 0.052 kg m^2, not 0.058",
        unit="kg m^2",
    )
    final = replace(diagnosis.final, stated=(refuted,))
    shown = replace(diagnosis, final=final, which=replace(diagnosis.which, verdict=verdict))
    page = diagnosis_page(shown)
    assert ("Write these values" in page) == (verdict != "unknown")
    names = [value.name for value in values_to_write(final)]
    effects = [f"{name} of {e}" for e in final.effects for name in e.parameters]
    assert names == ["inertia", *effects]


def test_a_verdict_that_is_alone_is_not_counted():
    assert counted(Counter(named=1)) == "named"
    assert counted(Counter(named=3, unknown=1)) == "named 3×, unknown 1×"


def test_what_is_left_is_drawn_where_something_was_supplied():
    """A second line over the first one would have its colour say that effects were added."""
    (force,) = sample_diagnosis().missing_force
    for after, lines in ((force.after, 2), (force.before, 1)):
        axes = Figure().add_subplot()
        draw_spectrum(axes, replace(force, after=after))
        assert len(axes.get_lines()) == lines


def test_what_was_left_out_of_runs_is_said_first(tmp_path):
    """Of the result that stands on parts of its runs, before what was found in them."""
    note = f"shapes of arm.xml {NOT_SIMULATED}: left out of run_1 (foot touches floor after 2 s)"
    found = replace(sample_diagnosis(), notes=(note,))
    said = text.diagnosis_text(found)
    assert said.index("LEFT OUT") < said.index("WHERE")
    page = diagnosis_page(found)
    assert page.index("Shapes of arm.xml touch") < page.index("Where is the simulator wrong?")
    assert "LEFT OUT" not in text.diagnosis_text(sample_diagnosis())


def test_ranges_to_write_have_as_many_digits_as_numbers():
    limits = [-22.12847087521902, 22.12847087521902]
    row = ExportRow("torque_scale", "j2", "forcerange", limits, "N m", "exact", "")
    assert carry.change(row).value == "[-22.13, 22.13]\u00a0N\u00a0m"


@pytest.mark.parametrize(
    ("ways", "commands"),
    [
        (None, ["export", "replay"]),
        (["exact", "code"], ["export", "replay"]),
        (["code"], ["export"]),
        (["none"], []),
        ([], []),
    ],
)
def test_only_commands_that_run_are_proposed(ways, commands):
    """A file that nothing is written into is not there to be replayed."""
    rows = None
    if ways is not None:
        rows = [ExportRow("armature", "lift", "", 0.1, "kg m^2", how, "") for how in ways]
    lines = carry._commands(rows, "mjcf", "diagnosis.json", "robot.xml")
    assert [line.split()[1] for line, _ in lines] == commands


def test_a_number_has_one_name_on_a_page_and_in_tables():
    fit = sample_diagnosis().final
    assert fit.effects
    names = [name for name, _ in parameter_rows(fit)]
    assert names == list(fit.to_frame()["parameter"])
