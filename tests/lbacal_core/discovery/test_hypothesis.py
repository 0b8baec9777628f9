from __future__ import annotations

from dataclasses import replace

from tests.lbacal_core.discovery.worlds import look_at


def labels(look):
    return [label for _, label, _ in look.targets()]


def test_paths_antennas_cables_and_the_station_are_targets(world):
    look = world.with_settings(antennas=8).look()
    scopes = [scope for scope, _, _ in look.targets()]
    cables = {record.cable for record in world.instrument.antennas if record.station == "CS002" and record.antenna < 8}
    assert scopes.count("path") == 16
    assert scopes.count("antenna") == 8
    assert scopes.count("cable") == len(cables) > 1
    assert scopes.count("station") == 1
    members = {label: paths for _, label, paths in look.targets()}
    assert members["antenna 3"] == [(3, "X"), (3, "Y")]
    assert members["antenna 3 Y"] == [(3, "Y")]
    assert sorted(members["station"]) == [(a, d) for a in range(8) for d in "XY"]
    for cable in cables:
        antennas = {r.antenna for r in world.instrument.antennas if r.station == "CS002" and r.cable == cable}
        assert members[f"cable {cable}"] == [(a, d) for d in "XY" for a in range(8) if a in antennas]


def test_antennas_of_one_board_are_a_target_unless_they_are_one_antenna_or_all(world):
    records = [
        replace(record, group={0: "board 1", 2: "board 1", 1: "board 2"}.get(record.antenna))
        for record in world.instrument.antennas
    ]
    targets = look_at(world.spectra(), replace(world.instrument, antennas=records), world.sky).targets()
    of_groups = [(label, paths) for scope, label, paths in targets if scope == "group"]
    assert of_groups == [("group board 1", [(0, "X"), (2, "X"), (0, "Y"), (2, "Y")])]
    everyone = replace(world.instrument, antennas=[replace(r, group="cabinet") for r in world.instrument.antennas])
    assert "group" not in {scope for scope, _, _ in look_at(world.spectra(), everyone, world.sky).targets()}


def test_sets_of_paths_that_coincide_are_one_target(world):
    spectra = world.spectra()
    one = spectra.select(spectra.antenna == 1)
    assert labels(look_at(one, world.instrument, world.sky)) == ["station"]
    one_dipole = spectra.select(spectra.dipole == "X")
    assert labels(look_at(one_dipole, world.instrument, world.sky)) == [
        "antenna 0 X",
        "antenna 1 X",
        "antenna 2 X",
        "station",
    ]
