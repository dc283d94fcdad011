"""The description of a robot in `robot.conf` and in the calibrations next to it."""

from __future__ import annotations

import platform
from pathlib import Path

import pytest

from rhdlink import Host, connect
from rhdlink.host.config import BadConfiguration
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.smrcl.motion.control import DriveKind
from rhdlink.smrcl.robot_conf import RobotConf, parse_robot_conf, read_robot_conf
from rhdlink.smrcl.robot_link import ClientLink, suitable_conf
from tests.rhdlink.smrcl.bench import Bench

#: Configuration of DTU's robots, adapted to the turtle.
TEXT = """<?xml version="1.0" ?>
<mrc>
 <odometry cl="0.00002" cr="0" w="0.26" ts="0.01" maxtick="10000" control="1"/>
 <motioncontrol ts="0.01" line_gain="0.05" line_tau="10" drive_kdist="4.8" drive_kangle="2.25"
   w="0.26" gain="1" kp="10" tau="0.16" alfa="0.2" lim="0.2" stopdist="0.18" alarmdist="0.1"
   velcmd="0.3" acccmd="0.25"/>
 <motorcontrol velscalel="100000" velscaler="40000" kp="66" ki="10"/>
 <robotinfo type="velomega" name="turtle"/>
 <filter size="3"/>
 <varscale name="adc[2]" offset="1" gain="0.5"/>
 <setpar module="motioncontrol" parlist="followwall" par="gain" val="2.5"/>
 <routeinput module="mrc" parlist="mrccontrol" par="stop" var="button"/>
</mrc>
"""


def test_file_describes_the_robot() -> None:
    conf = parse_robot_conf(TEXT)
    assert (conf.drive, conf.name, conf.heading_source) == (DriveKind.VELOMEGA, "turtle", 1)
    assert (conf.left_scale, conf.right_scale, conf.width, conf.max_tick) == (0.00002, 0.0, 0.26, 10000.0)
    assert (conf.speed, conf.acceleration) == (0.3, 0.25)
    assert (conf.left_speed_scale, conf.right_speed_scale) == (100000.0, 40000.0)
    assert (conf.motion.kp, conf.motion.limit, conf.motion.stop_distance) == (10.0, 0.2, 0.18)
    assert (conf.motion.drive_kdist, conf.motion.drive_kangle, conf.motion.line_tau) == (4.8, 2.25, 10.0)
    assert [(each.variable, each.offset, each.gain) for each in conf.scales] == [("adc[2]", 1.0, 0.5)]
    assert conf.settings[0].value == 2.5
    assert conf.routes[0].variable == "button"


def test_empty_file_gives_the_smr_defaults_of_mrc() -> None:
    assert parse_robot_conf("<mrc/>") == RobotConf()
    assert RobotConf().acceleration == 0.6


def test_mission_uses_the_scales_of_the_file() -> None:
    """With half the counts per metre, the robot drives half the distance."""
    conf = parse_robot_conf(TEXT.replace('cl="0.00002"', 'cl="0.00004"'))
    assert Bench("velomega", conf=conf).run("fwd 0.6\n").pose[0] == pytest.approx(0.3, abs=0.01)


def test_calibrations_are_read_next_to_the_file(tmp_path: Path) -> None:
    (tmp_path / "robot.conf").write_text("<mrc><linesensor size='8' k_filt='0.5'/></mrc>")
    name = platform.node()
    (tmp_path / f"{name}_demo_odo_calib.dat").write_text("0.27 1.02 0.0001 ; width, ratio, mean\n")
    (tmp_path / f"{name}_demo_ls_calib.dat").write_text("230 " * 8 + "\n" + "25 " * 8)
    (tmp_path / f"{name}_demo_ir_calib.dat").write_text("16 76\n" * 5 + "17 77\n")
    (tmp_path / "wdssparam.dat").write_text("1 2 3\n4 5 6\n")
    conf = read_robot_conf(tmp_path)
    assert conf.width == 0.27
    assert conf.right_scale / conf.left_scale == pytest.approx(1.02)
    assert (conf.right_scale + conf.left_scale) / 2 == pytest.approx(0.0001)
    assert (conf.line_white, conf.line_black) == ((230.0,) * 8, (25.0,) * 8)
    assert (conf.ir_k1[-1], conf.ir_k2[-1], conf.ir_k1[0]) == (17.0, 77.0, 16.0)
    assert conf.motion.wall_table == ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    assert read_robot_conf(tmp_path / "robot.conf").line_white is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<mrc>", "invalid XML"),
        ('<mrc><robotinfo type="ackerman"/></mrc>', "differential and velomega"),
        ('<mrc><odometry ts="0"/></mrc>', "ts has to be above 0"),
        ('<mrc><odometry w="x"/></mrc>', "w"),
        ('<mrc><linesensor size="99"/></mrc>', "size"),
        ("<mrc><varscale/></mrc>", 'missing name="..."'),
    ],
)
def test_invalid_file_raises_the_reason(text: str, said: str) -> None:
    with pytest.raises(BadConfiguration, match=said):
        parse_robot_conf(text)


@pytest.mark.parametrize("path", ["a\0b", "nowhere"])
def test_missing_file_is_a_configuration_error(path: str) -> None:
    with pytest.raises(BadConfiguration, match="cannot read"):
        read_robot_conf(path)


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [("ls", "1 2 3", "contains 3 numbers; expected 16"), ("odo", "a b c", "could not convert")],
)
def test_invalid_calibration_raises_the_reason(tmp_path: Path, kind: str, text: str, said: str) -> None:
    (tmp_path / "robot.conf").write_text("<mrc/>")
    (tmp_path / f"{platform.node()}_demo_{kind}_calib.dat").write_text(text)
    with pytest.raises(BadConfiguration, match=said):
        read_robot_conf(tmp_path)


def calibrated(folder: Path, *names: str) -> Path:
    """Return a folder with odometry calibrations of some robots; their widths are 0.21 m, 0.22 m, ..."""
    (folder / "robot.conf").write_text("<mrc/>")
    for number, name in enumerate(names):
        (folder / f"{name}_demo_odo_calib.dat").write_text(f"{21 + number}e-2 1.0 0.0001\n")
    return folder


def test_calibration_is_chosen_by_robot_or_by_name(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    calibrated(tmp_path, "smr1", "smr2", platform.node())
    assert read_robot_conf(tmp_path, robot="smr1").width == 0.21
    assert read_robot_conf(tmp_path, robot="smr2.elektro.dtu.dk").width == 0.22
    assert read_robot_conf(tmp_path, robot="localhost").width == 0.23
    assert read_robot_conf(tmp_path, robot="smr1", calibration="smr2").width == 0.22
    assert read_robot_conf(tmp_path / "robot.conf", calibration="smr2").width == 0.22
    assert "line sensors, infrared sensors not calibrated: there is no smr2_demo_ls_calib.dat" in caplog.text
    with pytest.raises(BadConfiguration, match=r"no smr3_demo_odo_calib.dat.*; there are calibrations of .*smr1, smr2"):
        read_robot_conf(tmp_path, calibration="smr3")


def test_missing_calibrations_are_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    calibrated(tmp_path, "smr1")
    assert read_robot_conf(tmp_path).width == RobotConf().width
    assert "odometry, line sensors, infrared sensors not calibrated" in caplog.text
    assert "there are calibrations of smr1, which you can select with `calibration`" in caplog.text


@pytest.mark.simulated_time
def test_mission_uses_the_calibration_of_its_robot(tmp_path: Path) -> None:
    with Host([Turtle()], port=0) as host, connect(host.address, access="w") as robot:
        link = ClientLink(robot)
        link.name = "smr7.elektro.dtu.dk:24902"
        (calibrated(tmp_path, "smr7") / "robot.conf").write_text(TEXT)
        assert suitable_conf(tmp_path, link).width == 0.21


@pytest.mark.parametrize("text", ["0 1 1e-4", "0.2 -1 1e-4", "nan 1 1e-4", "0.2 1 inf"])
def test_invalid_odometry_calibration_is_rejected(tmp_path: Path, text: str) -> None:
    (calibrated(tmp_path) / "smr1_demo_odo_calib.dat").write_text(text)
    with pytest.raises(BadConfiguration, match=r"above 0|not finite"):
        read_robot_conf(tmp_path, calibration="smr1")
