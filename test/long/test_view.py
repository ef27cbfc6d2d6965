"""Jobs in a browser: a headless Chromium opens the page, looks, clicks and presses keys."""

import contextlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
import rospy
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from playwright.sync_api import Error, sync_playwright
from sensor_msgs.msg import LaserScan
from visualization_msgs.msg import Marker, MarkerArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "rostest"))
from lab_testing import Master, Node, Topic, wait_for  # noqa: E402
from view_looker import wait_for_url  # noqa: E402

CENTIMETRE = 0.01
# Within so many seconds of the page's end, a robot that it drives has to be told to stand.
LATEST_STOP = 0.5
# And within so many of the end of the browser itself, it has to be at rest.
LATEST_REST = 0.6
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
def launch():
    """Start a Chromium."""
    # Chromium's own sandbox does not work for root.
    options = [*OPTIONS, "--no-sandbox"] if os.geteuid() == 0 else OPTIONS
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as playwright:
        yield lambda: playwright.chromium.launch(executable_path=program, args=options)


@pytest.fixture(scope="module")
def browser(launch):
    made = launch()
    yield made
    made.close()


@contextlib.contextmanager
def running(job, folder, *words):
    """Run a job with its page until Ctrl-C, and give the page's URL."""
    log = folder / "job.log"
    with log.open("w") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "bullet_lab.ros.launcher", job, "view:=browser", *words],
            cwd=folder,
            stdout=out,
            stderr=subprocess.STDOUT,
        )
    try:
        yield wait_for_url(log.read_text)
    finally:
        process.send_signal(2)
        process.wait(60.0)
    assert process.returncode == 0, log.read_text()


@contextlib.contextmanager
def opened(browser, url):
    """Open a page once its robot is there; all that it asks for is its own."""
    page = browser.new_page(viewport=SIZE)
    page.set_default_timeout(PATIENCE_MS)
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda line: asked.append(line.text) if "Refused" in line.text else None)
    page.goto(url)
    # Not wait_for_function, which the page's policy forbids.
    wait_for(lambda: page.evaluate(f"window.__viserSceneTree && '/robots/0' in {NODES}"), "a robot")
    page.evaluate("document.querySelector('.mantine-Notification-closeButton')?.click()")
    yield page
    if not page.is_closed():
        page.close()
    ours = (url, "data:", "blob:")
    assert not [one for one in asked if not one.startswith(ours)]


class Robot:
    """The robot of a job as ROS has it: where it is, what it is told, what it has reached."""

    def __init__(self):
        self.odom = Topic("/odom", Odometry, connected=False)
        self._states = Topic("/drive_to_goal/status", GoalStatus, connected=False)
        self._goals = Topic("/move_base_simple/goal", PoseStamped, connected=False)
        self.commands = []
        self._commands = rospy.Subscriber(
            "/cmd_vel", Twist, lambda m: self.commands.append((time.monotonic(), m))
        )

    def close(self):
        for topic in (self.odom, self._states, self._goals):
            topic.close()
        self._commands.unregister()

    def places(self, count=1):
        """Return where it was in so many messages of odometry, the newest; 0 for all."""
        return [message.pose.pose.position for message in self.odom.messages[-count:]]

    def reached(self):
        """Return how many goals were reached."""
        states = self._states.messages
        return len({m.goal_id.id for m in states if m.status == GoalStatus.SUCCEEDED})

    def speed(self):
        return self.odom.messages[-1].twist.twist.linear.x

    def is_at_newest_goal(self):
        goal, (place,) = self._goals.messages[-1].pose.position, self.places()
        return math.hypot(place.x - goal.x, place.y - goal.y) < 0.1


@pytest.fixture
def robot(master):
    made = Robot()
    yield made
    made.close()


def is_seen_in_its_place(page, robot):
    x, y, _ = page.evaluate(ROBOT)[:3]
    return min(math.hypot(x - p.x, y - p.y) for p in robot.places(100)) < CENTIMETRE


def hold(page, robot, key, shows, seconds):
    """Hold a key until the robot is told what shows it, and so long in simulated time."""
    page.keyboard.down(key)
    count = len(robot.commands)
    wait_for(lambda: any(shows(m) for _, m in robot.commands[count:]), f"{key} to drive")
    rospy.rostime.wallsleep(seconds)
    page.keyboard.up(key)
    wait_for(lambda: robot.commands[-1][1] == Twist(), "the robot to be stopped")


def click_on_the_floor(page, robot, pixel):
    before = robot.reached()
    # Through viser's controls, which take nothing for a click that moves.
    page.mouse.click(*pixel)
    wait_for(lambda: robot.reached() > before, "the goal that was clicked to be reached")
    assert robot.is_at_newest_goal()
    wait_for(lambda: is_seen_in_its_place(page, robot), "the robot to be seen there")


def close_while_driving(page, robot):
    page.keyboard.down("ArrowLeft")
    count = len(robot.commands)
    wait_for(lambda: any(m.angular.z > 0.0 for _, m in robot.commands[count:]), "to be driven")
    closed = time.monotonic()
    page.close()
    wait_for(lambda: robot.commands[-1][1] == Twist(), "the robot to be stopped")
    assert robot.commands[-1][0] - closed < LATEST_STOP


@pytest.mark.parametrize(
    ("job", "words", "wanted"),
    [
        ("squares", (), {"/topics/odom_path", "/topics/noisy_odom_path", "/frames/axes"}),
        (
            "dock",
            ("x:=0.5", "y:=1.0", "yaw:=150"),
            {"/topics/dock/plan", "/topics/dock/dock_pose", "/topics/bullet_lab/world/meshes/0"},
        ),
        ("sensors", (), {"/topics/scan", "/topics/sonar", "/topics/bumper"}),
    ],
)
def test_a_job_is_seen_and_its_robot_driven(job, words, wanted, robot, browser, tmp_path):
    with running(job, tmp_path, *words) as url:
        time.sleep(2.0)
        assert not robot.odom.messages, "time does not wait for somebody to look"
        with opened(browser, url) as page:
            seen = set()

            def look():
                time.sleep(1.0)
                assert is_seen_in_its_place(page, robot)
                names = page.evaluate(f"Object.keys({NODES})")
                seen.update(n for n in wanted if any(name.startswith(n) for name in names))
                return wanted <= seen

            wait_for(look, lambda: str(wanted - seen), 120.0)
            first, last = (robot.places(0)[n] for n in (0, -1))
            assert math.hypot(last.x - first.x, last.y - first.y) > 0.1
            keep(page, job)
            summary = tmp_path / "results" / job / "summary.json"
            wait_for(lambda: is_finished(summary), "the job to end", 240.0)
            hold(page, robot, "ArrowDown", lambda m: m.linear.x < 0.0, 3.0)
            click_on_the_floor(page, robot, (380, 330))
            keep(page, f"{job}_driven")
            close_while_driving(page, robot)


def is_finished(summary):
    return summary.is_file() and json.loads(summary.read_text()).get("finished", True)


def test_the_job_goal_takes_clicks_and_is_closed_to_strangers(robot, browser, tmp_path):
    with running("goal", tmp_path) as url, opened(browser, url) as page:
        wait_for(lambda: robot.reached() == 1, "the job's own goal to be reached")
        click_on_the_floor(page, robot, (230, 420))
        keep(page, "goal")
        close_while_driving(page, robot)

        stranger = browser.new_page()
        # A page from elsewhere, which even knows the token.
        stranger.goto("data:text/html,elsewhere")
        for address in (url, f"{url}drive"):
            said = stranger.evaluate(SOCKET, address.replace("http", "ws", 1))
            assert said == "error"
        with pytest.raises(Error, match="ERR_HTTP_RESPONSE_CODE_FAILURE"):
            stranger.goto(url.rsplit("/", 2)[0])
        stranger.close()


@pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGKILL])
def test_a_browser_that_hangs_or_dies_stops_the_robot(how, robot, launch, tmp_path):
    others = set(browser_processes())
    browser = launch()
    with running("goal", tmp_path) as url, opened(browser, url) as page:
        wait_for(lambda: robot.reached() == 1, "the job's own goal to be reached")
        page.keyboard.down("ArrowUp")
        wait_for(lambda: robot.speed() > 0.3, "to be driven")
        rospy.rostime.wallsleep(1.0)
        ours = set(browser_processes()) - others
        assert ours
        lost = time.monotonic()
        for process in ours:
            process.send_signal(how)
        wait_for(lambda: abs(robot.speed()) < 1e-3, "the robot to stand")
        assert time.monotonic() - lost < LATEST_REST
        assert robot.commands[-1][1] == Twist()
        if how == signal.SIGSTOP:
            for process in ours:
                process.send_signal(signal.SIGCONT)
    with contextlib.suppress(Error):
        browser.close()


def browser_processes():
    return [p for p in psutil.Process().children(recursive=True) if "chrom" in p.name()]


TAGS = ("script", "img", "iframe", "svg", "style", "a", "b", "object", "embed", "form")
SPRING = "window.__sprung = true; parent.__sprung = true"
SHAPES = (
    f"<{{0}} src=x onerror='{SPRING}' onload='{SPRING}'>{SPRING}</{{0}}>",
    f"<{{0}} srcdoc=\"<script>{SPRING}</script>\"></{{0}}>",
    "<{0} style='position:fixed;inset:0' href='http://evil.example' data='//evil.example'>x</{0}>",
    f"**[{{0}}](javascript:{SPRING})** ![{{0}}](http://evil.example/x.png) http://evil.example",
    f"&lt;{{0}}&gt;</div><{{0}} autofocus onfocus='{SPRING}'>",
)
MARKUP = [shape.format(tag) for shape in SHAPES for tag in TAGS]


def test_markup_in_names_is_text(master, browser, tmp_path):
    assert len(MARKUP) == 50
    nodes = [
        Node("pybullet_bridge.py", world="package://bullet_lab/worlds/empty.world"),
        Node("view.py", port=18090),
    ]
    try:
        url = wait_for_url(lambda: nodes[1].out)
        scans = rospy.Publisher("/scan", LaserScan, queue_size=100, latch=True)
        markers = rospy.Publisher("/texts", MarkerArray, queue_size=1, latch=True)
        texts = [Marker(ns=t, id=n, type=Marker.TEXT_VIEW_FACING) for n, t in enumerate(MARKUP)]
        for marker in texts:
            marker.header.frame_id, marker.text = "world", marker.ns
            marker.color.a = marker.scale.z = 1.0
        markers.publish(MarkerArray(texts))
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(PATIENCE_MS)
        asked, refused = [], []
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda line: refused.append(line.text))
        page.goto(url)
        there = f"window.__viserSceneTree && Object.keys({NODES}).length > 5"
        wait_for(lambda: page.evaluate(there), "the scene")
        inside = page.evaluate(ELEMENTS)
        for markup in MARKUP:
            scan = LaserScan(ranges=[1.0, 1.0], range_max=9.0, angle_increment=0.1)
            scan.header.frame_id = markup

            def shown(markup=markup, scan=scan):
                scans.publish(scan)
                time.sleep(0.2)
                return markup in page.evaluate("document.body.textContent")

            wait_for(shown, lambda markup=markup: markup)
        keep(page, "markup")
        assert page.evaluate(ELEMENTS) == inside
        assert not page.evaluate("Boolean(window.__sprung)")
        assert not [one for one in asked if not one.startswith((url, "data:", "blob:"))]
        assert not [one for one in refused if "Content Security Policy" in one]
        page.close()
    finally:
        for node in reversed(nodes):
            node.end()


# How many elements the page has that a name could bring.
ELEMENTS = (
    "document.querySelectorAll('script, iframe, object, embed, form, a, b, [onerror]').length"
)

# What becomes of a socket.
SOCKET = """address => new Promise(resolve => {
  const socket = new WebSocket(address);
  socket.onopen = () => resolve("open");
  socket.onerror = () => resolve("error");
})"""


def keep(page, name):
    """Put a picture of the page where the environment says, to be looked at."""
    folder = os.environ.get("LAB_PICTURES")
    if folder:
        page.screenshot(path=str(Path(folder) / f"{name}.png"))
