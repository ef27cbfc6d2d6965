"""Jobs in a browser: a headless Chromium opens the page, looks, clicks and presses keys."""

import contextlib
import math
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import rospy
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "rostest"))
from lab_testing import Master, Topic, wait_for  # noqa: E402
from view_looker import wait_for_url  # noqa: E402

CENTIMETRE = 0.01
# Within so many seconds of the page's end, a robot that it drives has to be told to stand.
LATEST_STOP = 0.5
PATIENCE_MS = 120_000
# A machine without a graphics card draws in software, which Chromium has to be asked for.
OPTIONS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE = {"width": 1000, "height": 620}
NODES = "window.__viserSceneTree.getState()"
ROBOT = f"Array.from({NODES}['/robots/0'].message.props.batched_positions)"


@pytest.fixture(scope="module")
def master():
    made = Master()
    os.environ.update(ROS_MASTER_URI=made.uri, ROS_IP="127.0.0.1")
    rospy.init_node("browser_test", disable_signals=True)
    yield made
    made.end()


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as playwright:
        # Chromium's own sandbox does not work for root.
        options = [*OPTIONS, "--no-sandbox"] if os.geteuid() == 0 else OPTIONS
        program = shutil.which("chromium") or shutil.which("chromium-browser")
        made = playwright.chromium.launch(executable_path=program, args=options)
        yield made
        made.close()


@contextlib.contextmanager
def running(job, folder, *words):
    """Run a job with its page, and give the page's URL."""
    log = folder / "job.log"
    with log.open("w") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "bullet_lab.ros.launcher", job, "view:=browser", *words],
            cwd=folder,
            stdout=out,
            stderr=subprocess.STDOUT,
        )
    try:
        yield wait_for_url(log.read_text, 120.0)
    finally:
        process.send_signal(2)
        process.wait(60.0)


@contextlib.contextmanager
def opened(browser, url):
    """Open a page once its robot is there; give it, and what it has asked for of elsewhere."""
    page = browser.new_page(viewport=SIZE)
    page.set_default_timeout(PATIENCE_MS)
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda line: asked.append(line.text) if "Refused" in line.text else None)
    page.goto(url)
    page.wait_for_function(f"window.__viserSceneTree && '/robots/0' in {NODES}")
    close = page.locator(".mantine-Notification-closeButton")
    if close.count():
        close.first.click()
    yield page
    if not page.is_closed():
        page.close()
    ours = (url, "data:", "blob:")
    assert not [one for one in asked if not one.startswith(ours)]


@pytest.mark.parametrize(
    ("job", "words", "wanted"),
    [
        ("squares", (), {"/topics/odom_path", "/topics/noisy_odom_path", "/frames/axes"}),
        (
            "dock",
            ("x:=0.5", "y:=1.0", "yaw:=150"),
            {"/topics/dock/plan", "/topics/dock/dock_pose", "/topics/bullet_lab/world/meshes/0"},
        ),
        ("sensors", (), {"/topics/scan", "/topics/sonar"}),
    ],
)
def test_the_robot_is_seen_where_odometry_says(job, words, wanted, master, browser, tmp_path):
    odom = Topic("/odom", Odometry, connected=False)
    # Slowly, so that it is not over before a busy machine has the page.
    with running(job, tmp_path, "rtf:=0.25", *words) as url, opened(browser, url) as page:
        seen = set()

        def look():
            time.sleep(2.0)
            x, y, _ = page.evaluate(ROBOT)[:3]
            places = [m.pose.pose.position for m in odom.messages[-100:]]
            assert min(math.hypot(x - p.x, y - p.y) for p in places) < CENTIMETRE
            seen.update(page.evaluate(f"Object.keys({NODES})"))
            moved = len({(round(p.x, 3), round(p.y, 3)) for p in places}) > 1
            return moved and wanted <= seen

        wait_for(look, lambda: str(wanted - seen))
        page.screenshot(path=str(tmp_path / f"{job}.png"))
        keep(tmp_path / f"{job}.png")
    odom.close()


def test_a_click_sends_a_goal_and_keys_drive_until_the_page_is_closed(master, browser, tmp_path):
    odom = Topic("/odom", Odometry, connected=False)
    goals = Topic("/move_base_simple/goal", PoseStamped, connected=False)
    states = Topic("/drive_to_goal/status", GoalStatus, connected=False)
    commands = []
    rospy.Subscriber("/cmd_vel", Twist, lambda m: commands.append((time.monotonic(), m)))
    with running("goal", tmp_path) as url, opened(browser, url) as page:
        wait_for(lambda: ends(states) == 1, "the job's own goal to be reached")
        before = len(goals.messages)
        # Through viser's controls, which take nothing for a click that moves.
        page.mouse.click(230, 420)
        goal = wait_for(lambda: goals.messages[before:], "a goal")[0].pose.position
        wait_for(lambda: ends(states) == 2, "the goal that was clicked to be reached")
        place = odom.messages[-1].pose.pose.position
        assert math.hypot(place.x - goal.x, place.y - goal.y) < 0.1
        page.screenshot(path=str(tmp_path / "goal.png"))
        keep(tmp_path / "goal.png")

        page.keyboard.down("ArrowUp")
        count = len(commands)
        wait_for(lambda: commands[count:] and commands[-1][1].linear.x > 0.0, "to be driven")
        closed = time.monotonic()
        page.close()
        wait_for(lambda: commands[-1][1] == Twist(), "to be stopped")
        assert commands[-1][0] - closed < LATEST_STOP
    for topic in (odom, goals, states):
        topic.close()


def ends(states):
    """Return how many goals were reached."""
    return len({m.goal_id.id for m in states.messages if m.status == GoalStatus.SUCCEEDED})


def keep(picture):
    """Put a picture where the environment says, to be looked at."""
    folder = os.environ.get("LAB_PICTURES")
    if folder:
        shutil.copy(picture, folder)
