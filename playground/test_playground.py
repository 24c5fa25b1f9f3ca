"""The page in a real browser, used as a person would use it. Without Chromium and playwright, most
tests are skipped, except in CI."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict
from http.client import HTTPConnection
from importlib.util import find_spec

import numpy as np
import pytest

import scenes
from evaluation.replay import make_page
from playground import choices
from playground.__main__ import main
from playground.choices import HERE, drivers, success_rates
from playground.server import MOST_PAGES, Feed, Server
from playground.session import Session
from support.test_cli import refusal
from support.weights import load_model

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ENV1 = scenes.load("env1")


@pytest.fixture(scope="module")
def served():
    """A session in env1, and its server."""
    session = Session("env1", "you")
    server = Server(session, 0, lambda: {"rooms": scenes.names(), "drivers": drivers()})
    for serve in (session.run, server.serve_forever):
        threading.Thread(target=serve, daemon=True).start()
    yield session, server
    server.shutdown()


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None or not find_spec("playwright"):
        if "CI" in os.environ:
            pytest.fail("CI needs Chromium and playwright")
        pytest.skip("needs Chromium and playwright (playground/requirements-test.txt)")
    from playwright import sync_api as playwright
    with playwright.sync_playwright() as started:
        launched = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield launched
        launched.close()


class Page:
    """A page of a browser or of one of its contexts, with the room's coordinates."""

    def __init__(self, browser, server, suffix="", **options):
        self.page = browser.new_page(**options)  # 1280 x 720 by default
        self.errors = []
        self.page.on("pageerror", lambda error: self.errors.append(error))
        self.page.goto(server.address + suffix)
        self.until("state !== null && room !== null && !busy")

    def __getattr__(self, name):
        return getattr(self.page, name)

    def until(self, expression, seconds=10):
        end = time.monotonic() + seconds
        while not self.page.evaluate(expression):
            assert time.monotonic() < end, expression
            time.sleep(0.02)

    def request(self, **what):
        self.page.evaluate(f"request({json.dumps(what)})")
        self.until("!busy")

    def at(self, x, y):
        """Returns the position in the window of a place in the room."""
        return self.page.evaluate(f"(() => {{ const p = new DOMPoint({x}, {-y}).matrixTransform("
                                  "$('map').getScreenCTM()); return [p.x, p.y]; })()")

    def drag(self, start, end):
        self.page.mouse.move(*self.at(*start))
        self.page.mouse.down()
        self.page.mouse.move(*self.at(*end), steps=8)
        self.page.mouse.up()
        self.until("!busy")
        time.sleep(0.1)


@pytest.fixture
def page(browser, served):
    session, server = served
    opened = Page(browser, server)
    opened.request(room="env1", run=False, driver="you", hide="", speed=16, keys=[])
    opened.request(robot=[-2.6, -2.6, 0.0], target=[-1.0, -2.9])
    yield opened
    assert not opened.errors
    opened.close()


def test_a_dragged_target_is_the_robots_target(page, served):
    page.drag((-1.0, -2.9), (-3.0, -2.2))
    assert np.allclose(served[0]._env.goals[0], (-3.0, -2.2), atol=0.03)


def test_a_dragged_robot_stands_there(page, served):
    page.drag((-2.6, -2.6), (-3.0, -2.2))
    assert np.allclose(served[0]._env.world.poses[0], (-3.0, -2.2, 0), atol=0.03)


def test_a_click_moves_what_was_clicked_before_but_only_once(page, served):
    for place in ((-1.0, -2.9), (-3.0, -2.2), (-2.6, -3.0)):
        page.mouse.click(*page.at(*place))
        page.until("!busy")
    assert np.allclose(served[0]._env.goals[0], (-3.0, -2.2), atol=0.03)


def test_number_fields_move_and_refuse(page, served):
    page.select_option("#thing", "target")
    page.fill("#x", "-3")
    page.fill("#y", "-2.2")
    page.click("#apply")
    page.until("!busy")
    assert np.allclose(served[0]._env.goals[0], (-3, -2.2))
    page.fill("#x", "-12")
    page.keyboard.press("Enter")
    message = "the target at (-12.00, -2.20) cannot be reached"
    page.until(f"$('message').textContent.includes('{message}')")
    assert np.allclose(served[0]._env.goals[0], (-3, -2.2))


def test_arrow_keys_drive_while_they_are_held(page, served):
    page.evaluate("document.activeElement.blur()")
    page.click("#run")
    page.keyboard.down("ArrowLeft")
    page.until("state.angular === 1")
    page.keyboard.up("ArrowLeft")
    page.until("state.angular === 0 && state.steps > 2")
    page.keyboard.down("ArrowUp")
    page.until("state.linear > 0")
    page.evaluate("window.dispatchEvent(new Event('blur'))")  # another window gets the keys
    page.until("state.linear === 0")
    page.keyboard.up("ArrowUp")


def test_buttons_drive_while_they_are_pressed(page, served):
    page.click("#run")
    x, y, width, height = page.locator("[data-key=ArrowUp]").bounding_box().values()
    page.mouse.move(x + width / 2, y + height / 2)
    page.mouse.down()
    page.until("state.linear > 0")
    page.mouse.up()
    page.until("state.linear === 0")


def test_a_planner_plans_again_when_something_is_moved(page):
    page.request(driver="oracle")
    page.drag((-1.0, -2.9), (-3.0, -2.2))
    page.until("state.plan.length > 0")
    assert np.allclose(page.evaluate("state.plan.at(-1)"), (-3.0, -2.2), atol=0.2)


def test_keys_override_a_policy_which_goes_on_thinking(page, served):
    page.request(driver="pretrained/env1")
    page.evaluate("document.activeElement.blur()")
    page.keyboard.down("ArrowLeft")
    page.until("keys.size === 1 && !busy")
    page.click("#step")
    page.until("state.steps === 1 && state.value !== undefined")
    assert page.evaluate("[state.linear, state.angular]") == [0, 1]
    page.keyboard.up("ArrowLeft")


def test_a_box_moves_is_refused_on_the_robot_and_can_be_undone(page, served):
    session, _ = served
    k, box = next((k, box) for k, box in enumerate(ENV1.boxes) if box.material == "wood")
    page.drag((box.x, box.y), (-3.2, -2.2))
    moved = session._scene.boxes[k]
    assert np.allclose((moved.x, moved.y), (-3.2, -2.2), atol=0.05)
    page.drag((-3.2, -2.2), (-2.6, -2.6))
    assert "the robot at (-2.60, -2.60) is outside the room, or closer to a box" in \
        page.text_content("#message")
    assert np.hypot(session._scene.boxes[k].x + 2.6, session._scene.boxes[k].y + 2.6) > 0.3
    page.click("#undo")
    page.click("#undo")
    page.until("!busy")
    assert session._scene.boxes[k] == box


def test_a_wall_is_drawn_turned_and_deleted(page, served):
    session, _ = served
    page.click("#draw")
    page.drag((-2.0, -3.2), (-1.4, -3.2))
    assert len(session._scene.boxes) == len(ENV1.boxes) + 1
    assert session._scene.boxes[-1].length == pytest.approx(0.6, abs=0.05)
    page.fill("#angle", "90")
    page.fill("#thickness", "0.25")
    page.select_option("#material", "brick")
    page.click("#apply")
    page.until("!busy")
    wall = session._scene.boxes[-1]
    assert wall.yaw == pytest.approx(np.pi / 2)
    assert (wall.thickness, wall.material) == (0.25, "brick")
    page.click("#delete")
    page.until("!busy")
    assert len(session._scene.boxes) == len(ENV1.boxes)
    page.click("#draw")
    page.mouse.click(*page.at(-2.0, -3.2))
    page.mouse.click(*page.at(-1.4, -3.2))
    page.until("!busy")
    assert session._scene.boxes[-1].length == pytest.approx(0.6, abs=0.05)
    page.click("#draw")
    page.drag((-2.0, -2.6), (-3.2, -2.6))  # through the robot
    assert len(session._scene.boxes) == len(ENV1.boxes) + 1
    page.until(f"boxes.length === {len(ENV1.boxes) + 1}")


def test_same_task_random_task_and_speed(page, served):
    session, _ = served
    page.click("#step")
    task = session._goal.tolist(), session._task[1].tolist()
    page.click("#again")
    page.until("state.steps === 0 && !busy")
    assert (session._goal.tolist(), session._pose.tolist()) == task
    page.click("#another")
    page.until("!busy")
    assert session._goal.tolist() != task[0]
    page.select_option("#speed", "8")
    page.until("state.speed === 8")


def test_another_room_has_nothing_to_undo(page):
    page.click("#draw")
    page.drag((-2.0, -3.2), (-1.4, -3.2))
    assert page.is_enabled("#undo")
    page.select_option("#room", "env2")
    page.until("room.name === 'env2'")
    assert page.is_disabled("#undo") and page.input_value("#thing") == "target"


def test_from_the_start_each_target_takes_its_turn(page, served):
    goals = []
    for _ in range(4):
        page.click("#start")
        page.until("!busy")
        goals.append(served[0]._env.goals[0].tolist())
        assert np.allclose(served[0]._env.world.poses[0, :2], ENV1.start[:2])
    assert np.allclose(goals, [*ENV1.targets, ENV1.targets[0]])


def test_after_a_choice_in_a_list_the_arrow_keys_drive(page):
    page.select_option("#driver", "oracle")
    page.select_option("#driver", "you")
    page.click("#run")
    page.keyboard.down("ArrowRight")
    page.until("state.angular === -1 && state.driver === 'you'")
    page.keyboard.up("ArrowRight")


def test_the_image_is_the_cameras_and_hiding_takes_the_cube(page, served):
    page.request(robot=[-2.6, -2.6, 3.14], target=[-3.2, -2.6])
    pixels = np.array(page.evaluate("Array.from($('camera').getContext('2d')"
                                    ".getImageData(0, 0, 64, 48).data)")).reshape(48, 64, 4)
    shown = served[0]._seen["image"][0]
    assert np.array_equal(pixels[..., :3], shown)
    is_blue = (pixels[..., 2] > 100) & (pixels[..., 0] < 40)
    page.select_option("#hide", "cube")
    page.until("state.hide === 'cube'")
    hidden = served[0]._seen["image"][0]
    page.select_option("#hide", "both")
    page.until("$('facts').textContent.includes('hidden')")
    assert is_blue.sum() > 20 and not ((hidden[..., 2] > 100) & (hidden[..., 0] < 40)).any()


@pytest.mark.parametrize("driver", ["oracle", "bug", "pretrained/any-room"])
def test_each_kind_of_driver_drives(page, driver):
    page.select_option("#driver", driver)
    page.click("#run")
    page.until(f"state.driver === '{driver}' && state.steps > 3 && state.linear > 0", 60)


def test_drivers_are_compared_on_one_task(page, served):
    page.click("summary")
    page.check("[type=checkbox][value=oracle]")
    page.check("[type=checkbox][value=bug]")
    page.click("#compare")
    page.until("paths.length === 2 && !state.runs", 60)
    assert [path["driver"] for path in page.evaluate("paths")] == ["oracle", "bug"]
    starts = page.evaluate("paths.map(path => path.points[0])")
    assert starts[0] == starts[1]
    assert page.locator("#map text").count() == 2


def test_reload_and_links_keep_room_driver_and_hidden_parts(page, browser, served):
    page.select_option("#room", "maze4")
    page.select_option("#driver", "oracle")
    page.until("room.name === 'maze4' && state.driver === 'oracle'")
    assert page.url.endswith("#room=maze4&driver=oracle")
    page.reload()
    page.until("room !== null && room.name === 'maze4'")
    other = Page(browser, served[1], "#room=env2&driver=bug&hide=place")
    other.until("room.name === 'env2' && state.driver === 'bug' && state.hide === 'place'")
    other.close()


def test_a_saved_room_can_be_opened_again(page, served, tmp_path):
    page.drag((-1.0, -2.9), (-3.0, -2.2))
    with page.expect_download() as saved:
        page.click("#save")
    saved.value.save_as(tmp_path / "my_room.toml")
    assert [box.x for box in scenes.load(tmp_path / "my_room.toml").boxes] \
        == pytest.approx([box.x for box in ENV1.boxes], abs=1e-3)
    page.set_input_files("#open", tmp_path / "my_room.toml")
    page.until("room.name === 'my_room'")
    (tmp_path / "bad.toml").write_text("start = 1")
    page.set_input_files("#open", tmp_path / "bad.toml")
    page.until("$('message').textContent.includes('bad.toml')")
    assert served[0]._scene.name == "my_room"


def test_too_many_pages_end_the_oldest(browser, served):
    context = browser.new_context()  # its pages share six connections to a server
    pages = [Page(context, served[1]) for _ in range(8)]
    for k, page in enumerate(pages):
        is_off = page.evaluate("$('message').textContent.includes('This page is off')")
        assert is_off is (k < 8 - MOST_PAGES)
    pages[-1].request(speed=2)
    pages[-MOST_PAGES].until("state.speed === 2")
    context.close()


def test_a_page_that_does_not_read_its_end_stops_nobody():
    feed = Feed()
    feed.publish(state=1)
    pages = [feed.follow() for _ in range(MOST_PAGES + 1)]
    for page in pages:
        next(page)
    assert next(pages[0]).startswith("event: end")  # its thread may now wait for the browser
    other = threading.Thread(target=feed.publish, kwargs={"state": 2}, daemon=True)
    other.start()
    other.join(5)
    assert not other.is_alive()


def test_with_reduced_motion_the_robot_does_not_glide(browser, served):
    page = Page(browser, served[1], reduced_motion="reduce")
    page.request(driver="oracle", speed=0.25)
    page.click("#step")
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    x, y, _ = page.evaluate("state.pose")
    assert page.get_attribute("[data-thing=robot]", "transform").startswith(f"translate({x} {-y})")
    page.close()


def test_a_replay_shows_the_same_drawing(browser, tmp_path):
    model, _ = load_model(HERE / "pretrained" / "env1.safetensors")
    text = make_page("env1", model, "mean", ENV1, "start", 0)
    (tmp_path / "replay.html").write_text(text, encoding="utf-8")
    page = browser.new_page()
    errors = []
    page.on("pageerror", lambda error: errors.append(error))
    page.goto((tmp_path / "replay.html").as_uri())
    assert page.locator("#map polygon").count() == len(ENV1.boxes)
    page.keyboard.press("End")
    end = page.evaluate("episode.poses.at(-1)")
    place = page.locator("#map > g").last.get_attribute("transform")
    assert place.startswith(f"translate({end[0]} {-end[1]})")
    strips = page.locator("#strips canvas").evaluate_all("all => all.map(one => new Set(one"
        ".getContext('2d').getImageData(0, 0, one.width, one.height).data).size)")
    assert len(strips) == 3 and min(strips) > 50 and not errors  # many shades
    page.close()


def test_without_a_page_nothing_moves(served):
    session, _ = served
    end = time.monotonic() + 30
    while session.pages:
        time.sleep(0.1)
        assert time.monotonic() < end
    assert session.ask({"run": True, "another": True}) == ""
    time.sleep(0.2)
    before = session._steps, time.process_time()
    time.sleep(1.0)
    assert session._steps == before[0] and time.process_time() - before[1] < 0.3


@pytest.mark.parametrize("options", [{}, {"viewport": {"width": 390, "height": 844}},
                                     {"color_scheme": "dark", "reduced_motion": "reduce"}])
def test_every_control_has_a_name_and_nothing_is_cut_off(browser, served, options):
    page = Page(browser, served[1], **options)
    for role in ("button", "combobox", "spinbutton", "img", "checkbox"):
        for control in page.get_by_role(role).all():
            name = control.evaluate("e => e.ariaLabel || e.labels?.[0]?.textContent || "
                                    "e.textContent")
            assert name.strip(), control
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    if not options:  # a projector
        for id in ("camera", "map", "run", "draw", "save"):
            assert page.locator(f"#{id}").bounding_box()["y"] < 700
            box = page.locator(f"#{id}").bounding_box()
            assert box["y"] + box["height"] <= 720
    page.close()


def test_a_run_that_is_deleted_while_it_drives(page, tmp_path, monkeypatch):
    (tmp_path / "one").mkdir()
    shutil.copy(HERE / "pretrained" / "env1.safetensors", tmp_path / "one/model.safetensors")
    rows = [f"{k},env1,0,0,training,{'arrival' if k % 2 else 'collision'},0,9" for k in range(400)]
    (tmp_path / "one" / "episodes.csv").write_text("\n".join(
        ["steps,scene,target_x,target_y,kind,outcome,return,length", *rows, "400,env1"]))
    monkeypatch.setitem(choices.FOLDERS, "runs", tmp_path)
    page.request(driver="runs/one", run=True)
    page.until("state.value !== undefined && !$('training').hidden")
    assert "last 100 episodes: training targets 50 %" in page.text_content("#rates")
    shutil.rmtree(tmp_path / "one")
    page.request(again=True)
    page.until("state.driver === 'runs/one' && state.steps > 2")
    page.request(driver="runs/one")
    page.until("$('message').textContent.includes('there is no driver')")


def test_newer_weights_of_a_run_drive_the_next_episode(page, served, tmp_path, monkeypatch):
    file = tmp_path / "lr0.001" / "model.safetensors"
    file.parent.mkdir()
    shutil.copy(HERE / "pretrained" / "env1.safetensors", file)
    monkeypatch.setitem(choices.FOLDERS, "runs", tmp_path)
    page.request(driver="runs/lr0.001")
    first = served[0]._driver
    page.request(again=True)
    assert served[0]._driver is first
    os.utime(file, ns=(1, 1))
    page.request(again=True)
    assert served[0]._driver is not first
    file.write_text("broken")
    newest = served[0]._driver
    page.request(again=True)
    assert served[0]._driver is newest and "has no weights" in page.text_content("#message")
    page.request(driver="you")


@pytest.mark.parametrize("line", ["1,env1", "1,env1,0,0,odd,arrival,0,9", "x" * 99, "\xff"])
def test_a_damaged_table_has_no_curves(tmp_path, line):
    rows = "1,env1,0,0,new,arrival,0,9\n" * 200
    head = "steps,scene,target_x,target_y,kind,outcome,return,length\n"
    (tmp_path / "episodes.csv").write_text(head + rows + "\n" * 2, encoding="latin-1")
    assert success_rates(tmp_path)["new"][-1] == [1, 1]
    (tmp_path / "episodes.csv").write_text(line + "\n" + line + "\n" + rows, encoding="latin-1")
    assert success_rates(tmp_path) == {}


def test_a_failing_driver_pauses_the_page(page, served):
    page.request(driver="oracle")
    served[0]._driver.act = lambda env, observations: 1 / 0
    page.click("#run")
    page.until("!state.runs && state.message.includes('ZeroDivisionError')")
    page.request(driver="oracle")
    served[0]._driver.planners[0].path = 3  # fails when it is shown
    page.click("#step")
    page.until("state.driver === 'you' && state.message.includes('TypeError')")


def test_a_new_page_releases_the_keys_of_one_that_crashed(page, browser, served):
    page.request(keys=["ArrowLeft"])
    assert served[0]._held == {"ArrowLeft"}
    Page(browser, served[1]).close()
    assert served[0]._held == set()


def test_a_tap_counts_for_one_step(page):
    page.request(keys=["ArrowLeft"])
    page.request(keys=[])
    page.click("#step")
    page.until("state.steps === 1")
    assert page.evaluate("state.angular") == 1
    page.click("#step")
    page.until("state.steps === 2")
    assert page.evaluate("state.angular") == 0


# ------------------------------------------------------------------------------- hostile requests


def status(server, method, path, headers, body=None):
    """Returns the status of a request with exactly these headers. body: bytes, or only a number of
    bytes, which are announced but not sent: the server answers before it has read them."""
    connection = HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    connection.putrequest(method, path, skip_host=True)
    for name, value in headers.items():
        connection.putheader(name, value)
    if body is not None:
        connection.putheader("Content-Length", str(body if isinstance(body, int) else len(body)))
    connection.endheaders(None if isinstance(body, int) else body)
    return connection.getresponse().status


def test_only_its_own_page_can_read_or_steer(served):
    session, server = served
    assert server.server_address[0] == "127.0.0.1"
    root = server.root
    own = {"Host": f"127.0.0.1:{server.server_port}"}
    assert status(server, "GET", root, own) == 200
    assert status(server, "GET", root, {"Host": "localhost:9"}) == 200  # through `ssh -L 9:...`
    for host in ("evil.test", f"127.0.0.1.evil.test:{server.server_port}", ""):
        assert status(server, "GET", root, {"Host": host}) == 404
    assert status(server, "GET", root, {}) == 404
    for path in ("/", "/events", root + "../../etc/passwd", root + "page.html", root[:-2]):
        assert status(server, "GET", path, own) == 404
    speed = session._speed
    as_json = own | {"Content-Type": "application/json"}
    for origin in ("http://evil.test", "null", f"https://127.0.0.1:{server.server_port}"):
        assert status(server, "POST", root + "do", as_json | {"Origin": origin},
                      b'{"speed": 3}') == 404
        assert status(server, "GET", root + "events", own | {"Origin": origin}) == 404
    assert status(server, "POST", "/do", as_json, b'{"speed": 3}') == 404
    assert status(server, "POST", root + "do", own | {"Content-Type": "text/plain"},
                  b'{"speed": 3}') == 415
    assert status(server, "POST", root + "do", as_json, 2 * 10 ** 6) == 413
    for body in (b"speed", b"[]", b"[" * 10 ** 5, b'{"speed": NaN}'):
        assert status(server, "POST", root + "do", as_json, body) == 400
    assert session._speed == speed
    assert status(server, "POST", root + "do", as_json | {"Origin": f"http://{own['Host']}"},
                  b'{"speed": 3}') == 200 and session._speed == 3


def test_bad_requests_get_one_sentence(served):
    session, _ = served
    session.ask({"room": "env1"})
    outside = [asdict(box) | {"x": box.x - 9.0} for box in ENV1.boxes]
    assert "is outside the room" in session.ask({"boxes": {"room": "env1", "boxes": outside}})
    assert "another page" in session.ask({"boxes": {"room": "env2", "boxes": outside}})
    for request in ({"room": "../x"}, {"room": "/etc/passwd"}, {"room": 3}, {"target": [1]},
                    {"robot": [0, 0, None]}, {"boxes": 3},
                    {"boxes": {"room": "env1", "boxes": [{}]}}, {"driver": "x/y"},
                    {"driver": []}, {"hide": "x"}, {"nothing": 1}, {"speed": "fast"}, {"file": 3},
                    {"compare": 3}, {"compare": []}, {"compare": ["x"]}, {"keys": 3}, {"speed": 99},
                    {"file": {"name": "..toml", "text": scenes.to_toml(ENV1)}},
                    {"target": [float("nan"), 0]}):
        message = session.ask(request)
        assert message and "\n" not in message, request
    assert session.ask({"another": True}) == ""


# -------------------------------------------------------------------------------- the command line


def test_the_program_prints_an_address_and_ctrl_c_ends_it_with_one_line():
    process = subprocess.Popen([sys.executable, "-m", "playground", "--port", "0", "--no-browser"],
                               cwd=HERE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline().startswith("http://127.0.0.1:")
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 0 and process.stderr.read() == ""
    assert process.stdout.read().splitlines()[-1] == "ended"


@pytest.mark.parametrize("arguments, words", [
    (["--room", "nowhere"], "unknown scene 'nowhere'"), (["--driver", "runs/none"], "there is no"),
    (["--port", "99999"], "from 0 to 65,535"), (["--port", "used"], "is not a whole number")])
def test_a_wrong_option_is_one_sentence(arguments, words, capsys):
    assert words in refusal(main, arguments, capsys)


def test_a_used_port_is_one_sentence(served, capsys):
    port = str(served[1].server_port)
    assert "Address already in use" in refusal(main, ["--port", port], capsys)
