"""The bench's calls of calibrate: gravity is that of the place, a refused one is tried again, nothing is used unasked."""

import asyncio
import json
from dataclasses import fields
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

pytest.importorskip("nicegui")

from undrift.commands.bench.library import StoredFile
from undrift.commands.correct import correct
from undrift.errors import InputError
from undrift.units import STANDARD_GRAVITY, gravity_at
from undrift.web.bench import Bench, ServerSettings, Working
from undrift.web.commands import CommandOutcome
from undrift.web.parts import page_words
from undrift.web.place import Site, place_of, towns
from undrift.web.result import certify

FITTED = {"accel": {}, "gyro": {}, "provenance": {"settings": {"gravity": "standard"}}}


@pytest.fixture
def bench(tmp_path):
    made = Bench(ServerSettings(folder=tmp_path / "bench"))
    made.calls, made.answer = [], CommandOutcome(code=0, answer={"data": FITTED})

    async def command(*words, folder=None):
        made.calls.append([str(word) for word in words])
        return made.answer

    made.command = command
    yield made
    made.close()


def test_a_town_a_latitude_or_gravity_state_the_place_and_nothing_states_none():
    assert place_of(" vienna ") == Site(latitude_deg=48.2, height_m=170.0)
    assert place_of("48,2", "300").gravity_m_s2 == gravity_at(48.2, 300.0)
    assert place_of("", "", "9.81").words() == ("--gravity-m-s2", 9.81)
    assert (place_of("").words(), place_of("").gravity_m_s2) == ((), STANDARD_GRAVITY)
    assert all(abs(latitude) <= 90.0 and -10.0 <= height < 4000.0 for latitude, height in towns().values())


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (("Atlantis",), "town: expected a town of the list, or its latitude in deg, got 'Atlantis'"),
        (("91",), "latitude: expected -90 to 90 deg, got 91"),
        (("48", "high"), "height: expected metres above the sea, got 'high'"),
        (("48", "10000"), "height: expected -500 to 9000 m"),
        (("", "", "981"), "gravity: expected 9.7 to 9.9 m/s2, got 981"),
    ],
)
def test_a_place_that_is_none_is_refused(typed, words):
    with pytest.raises(InputError, match=words):
        place_of(*typed)


def test_gravity_of_the_place_is_stated_unless_the_session_does_and_kept_for_the_next_time(bench):
    job = bench.new_job()
    job.session.mkdir()
    (job.session / "session.toml").write_text('[session]\nkind = "calibration"\n')
    asyncio.run(bench.calibrate(job, job.session))
    assert not {"--gravity-m-s2", "--latitude-deg"} & set(bench.calls[-1])
    assert job.gravity_assumed
    bench.set_place(place_of("Oslo"))
    asyncio.run(bench.calibrate(job, *job.words))
    assert bench.calls[-1][:6] == [
        "calibrate",
        f"jobs/{job.folder.name}/session",
        "--latitude-deg",
        "59.9",
        "--height-m",
        "20.0",
    ]
    (job.session / "session.toml").write_text('[session]\nkind = "calibration"\ngravity_m_s2 = 9.81\n')
    asyncio.run(bench.calibrate(job, *job.words))
    assert "--latitude-deg" not in bench.calls[-1]
    assert Bench(bench.settings).place == bench.place


def test_a_job_of_an_earlier_day_is_calibrated_by_the_words_it_was(bench):
    job = bench.new_job("A17")
    asyncio.run(bench.calibrate(job, bench.folder / "uploads" / "x" / "walk.csv", "--turn-deg", 360.0))
    (job.folder / "calibration.json").write_text(json.dumps(FITTED))
    shown = Bench(bench.settings).visit.job
    assert (shown.words, shown.serial, shown.answer) == (("uploads/x/walk.csv", "--turn-deg", "360.0"), "A17", FITTED)


def test_a_calibration_without_accelerometers_is_not_used_unasked(bench):
    job = bench.new_job()
    bench.answer = CommandOutcome(code=0, answer={"data": {"gyro": {}, "accel": None}})
    (job.folder / "calibration.json").write_text("{}")
    visit = bench.visit
    asyncio.run(visit.calibrate(job, "walk.csv"))
    assert job.lacks == ("accelerometers",)
    assert visit.calibration is None
    bench.answer = CommandOutcome(code=0, answer={"data": FITTED})
    asyncio.run(visit.calibrate(job, "walk.csv"))
    assert (job.lacks, visit.calibration) == ((), job.folder / "calibration.json")


def test_sides_that_were_chosen_define_the_pitch_of_orient_and_validate(bench):
    held, one = bench.visit.recordings, StoredFile(path=bench.folder / "uploads" / "walk.csv")
    held.form.forward, held.form.up = "-z", "+x"
    for work in (held.run(one, "orient"), held.validate(one, one), held.run(one, "correct")):
        asyncio.run(work)
    orient, validate, correct = bench.calls
    for call in (orient, validate):
        assert call[call.index("--forward") + 1] == "-z"
        assert call[call.index("--up") + 1] == "+x"
    assert "--forward" not in correct


def test_a_mounting_that_is_found_is_kept_in_the_calibration_or_named_by_sides(bench):
    held, one = bench.visit.recordings, StoredFile(path=bench.folder / "uploads" / "walk.csv")
    with pytest.raises(InputError, match="choose the body segment"):
        asyncio.run(held.mount(one))
    held.form.worn, held.form.movement = "lower-back", "bow"
    found = {"statement": "Shank: side -z", "sides": {"forward": "-z", "up": "+x"}, "output": None}
    bench.answer = CommandOutcome(code=0, answer=found)
    asyncio.run(held.mount(one))
    assert "-o" not in bench.calls[-1]
    assert "--output" not in bench.calls[-1]
    assert (held.form.forward, held.form.up, one.mounting) == ("-z", "+x", "Shank: side -z")
    held.visit.calibration = bench.folder / "calibration.json"
    bench.answer = CommandOutcome(code=0, answer=found | {"output": "uploads/walk-worn.json"})
    asyncio.run(held.mount(one))
    words = " ".join(bench.calls[-1])
    assert "--worn lower-back --movement bow --calibration" in words
    assert held.visit.calibration == one.path.with_name("walk-worn.json")
    asyncio.run(held.run(one, "orient"))
    assert "--forward" not in bench.calls[-1]
    assert str(held.visit.calibration) in bench.calls[-1]
    bench.answer = CommandOutcome(code=1, answer={"output": None, "mounting": None})  # what shows forward is missing
    asyncio.run(held.mount(one))
    assert (one.mounting, held.visit.calibration) == ("", one.path.with_name("walk-worn.json"))


def test_the_offset_that_was_chosen_is_subtracted_by_correct_orient_and_validate_alone(bench):
    held, one = bench.visit.recordings, StoredFile(path=bench.folder / "uploads" / "walk.csv")
    asyncio.run(held.run(one, "orient"))
    assert "--offset" not in bench.calls[-1]  # each command then does what it does by itself
    for chosen in get_args(get_type_hints(correct)["offset"]):
        assert chosen in {field.name: field for field in fields(held.form)}["offset"].metadata["options"]
        held.form.offset = chosen
        for work in (held.run(one, "orient"), held.validate(one, one), held.run(one, "correct")):
            asyncio.run(work)
            call = bench.calls[-1]
            assert call[call.index("--offset") + 1] == chosen
    asyncio.run(held.calibrate_by(one, one))
    assert "--offset" not in bench.calls[-1]


def test_a_recording_is_calibrated_by_its_motion_where_that_is_chosen(bench):
    held, one = bench.visit.recordings, StoredFile(path=bench.folder / "uploads" / "walk.csv")
    with pytest.raises(InputError, match="serial number: enter the number on the device"):
        asyncio.run(held.calibrate(one, turn_deg=None))
    one.serial = "A17"
    for motion in (False, True):
        asyncio.run(held.calibrate(one, turn_deg=360.0, motion=motion))
        call = [str(word) for word in bench.calls[-1]]
        assert ("--from" in call, "--turn-deg" in call) == (motion, not motion)
        assert call[call.index("--serial") + 1] == "A17"
    assert call[call.index("--from") + 1] == "motion"


def test_a_rate_that_a_command_asks_for_can_be_stated_on_the_page(bench):
    one = StoredFile(path=bench.folder / "no" / "walk.csv", about={"kind": "recording"}, map=Path("map.toml"))
    one.error = "walk.csv: wanted 50 samples a second, got 100; say --sample-rate-hz 100"
    assert one.needs_rate
    assert page_words(one.error).endswith("say “Samples per second, Hz” 100")
    asyncio.run(bench.visit.recordings.state_rate(one, 100.0))
    assert bench.calls[0][2:6] == ["--map", "map.toml", "--sample-rate-hz", "100.0"]
    assert not one.needs_rate


def test_options_are_called_as_the_page_calls_them():
    assert (
        page_words("give --latitude-deg and --height-m")
        == "give “Town, or latitude in deg” and “Height above the sea, m”"
    )
    assert page_words("give `latitude_deg`, or `rest_s`") == "give “Town, or latitude in deg”, or `rest_s`"
    assert page_words("say --gyro none") == "say “Calibrate the accelerometers only”"
    assert page_words("say --upload-mb 5") == "say --upload-mb 5"


def test_what_each_offset_gives_is_what_correct_answers_or_why_it_does_not(bench):
    visit, one = bench.visit, StoredFile(path=bench.folder / "uploads" / "walk.csv")
    visit.calibration = bench.folder / "c.json"
    answers = {
        "none": CommandOutcome(code=0, answer={"recordings": [{"rest": None}]}),
        "rest": CommandOutcome(code=2, error="walk.csv: wanted a rest, got none"),
        "motion": CommandOutcome(
            code=0,
            answer={
                "recordings": [
                    {"rest": {"offset_dps": [0.1, -0.2, -0.0001], "offset_uncertainty_dps": [0.03, 0.0, 0.04]}}
                ]
            },
        ),
    }

    async def command(*words, folder=None):
        return answers[words[words.index("--offset") + 1]]

    bench.command = command
    asyncio.run(visit.recordings.compare_offsets(one))
    assert visit.recordings.offsets[one.path] == {
        "none": "nothing is subtracted",
        "rest": "walk.csv: wanted a rest, got none",
        "motion": "0.100, -0.200, 0.000 deg/s about x, y, z, within 0.1 (95 %)",
    }


def test_the_certificate_states_what_was_typed(bench):
    job = bench.new_job()
    asyncio.run(certify(bench, job, {"laboratory": " Lab ", "number": "", "operator": "Ann"}))
    call = bench.calls[-1]
    assert call[call.index("--laboratory") + 1] == "Lab"
    assert call[call.index("--operator") + 1] == "Ann"
    assert "--number" not in call


def test_how_far_a_command_is_is_what_it_states():
    now = Working("calibrate", line="undrift calibrate: fitting, 9 s so far, about 9 s left (50 %)")
    assert now.share == 0.5
    now.line = "undrift calibrate: reading, 9 s so far, time left not known yet"
    assert now.share is None
