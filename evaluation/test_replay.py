"""Each test is the shortest proof of one claim about the replay in a browser."""

import base64
import io
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
import torch
from PIL import Image

import scenes
from evaluation.__main__ import main
from evaluation.replay import COLUMNS, as_sheet, as_strip, make_page
from model import REWARD_SCALE
from navbot_min import NavVecEnv
from render import H, W
from sim import MAX_LINEAR_VELOCITY
from support.pictures import PALETTE
from support.weights import load_run

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
PLAYED = """
<script>
const said = {errors: []};
window.onerror = message => { said.errors.push(message); };
const frame = () => Array.from($("camera").getContext("2d").getImageData(0, 0, 64, 48).data);
setTimeout(() => {
  const slider = $("time");
  slider.value = STEP;
  slider.dispatchEvent(new Event("input"));
  said.scrubbed = robot.getAttribute("transform");
  said.frame = frame();
  said.facts = $("facts").innerText;
  said.lines = Array.from(document.querySelectorAll("#map polyline"), line =>
    line.getAttribute("points"));
  said.steps = ["back", "on", "on"].map(id => { $(id).click(); return step; });
  document.dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowLeft"}));
  said.left = step;
  const plot = $("rewards"), box = plot.getBoundingClientRect();
  plot.dispatchEvent(new PointerEvent("pointerdown", {
    buttons: 1, clientX: box.left + box.width / 4, clientY: box.top + 5}));
  said.clicked = step;
  $("episode").value = "1";
  $("episode").dispatchEvent(new Event("change"));
  said.second = $("facts").innerText;
  choose(0);
  document.dispatchEvent(new KeyboardEvent("keydown", {key: "Home"}));
  said.home = step;
  document.dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowRight"}));
  said.right = step;
  $("play").click();
  setTimeout(() => {
    said.played = step;
    said.moved = robot.getAttribute("transform");
    document.dispatchEvent(new KeyboardEvent("keydown", {key: " "}));
    said.paused = step;
    setTimeout(() => {
      said.still = step;
      choose(data.episodes.length - 1);
      said.last = $("title").textContent + $("episode").selectedOptions[0].textContent;
      const pre = document.createElement("pre");
      pre.id = "said";
      pre.textContent = JSON.stringify(said);
      document.body.append(pre);
    }, 500);
  }, 1000);
}, 500);
</script>
"""


@pytest.fixture(scope="module")
def page():
    """A page of the policy in pretrained/env1.pt."""
    model, [scene, *_] = load_run("pretrained/env1.pt")
    return make_page("the title", model, "mean", scene, "anywhere", seed=0)


def content_of(page):
    """The data of a page."""
    return json.loads(re.search(r'type="application/json">(.*?)</script>', page, re.DOTALL)[1])


def points_of(polyline):
    """The corners (n, 2) of an SVG polyline."""
    return np.array([[float(number) for number in pair.split(",")] for pair in polyline.split()])


def frames(url, count):
    """The images (count, H, W, 3) of a data URL."""
    sheet = np.array(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGB"))
    rows = sheet.reshape(-1, H, COLUMNS, W, 3).swapaxes(1, 2)
    return rows.reshape(-1, H, W, 3)[:count]


def test_a_sheet_holds_every_image_in_its_place():
    flat = np.arange(20, dtype=np.uint8)[:, None, None, None]
    images = np.broadcast_to(10 * flat, (20, H, W, 3))
    assert np.array_equal(frames(as_sheet(images), 20), images)


def test_a_strip_holds_every_value_in_its_place():
    values = np.array([[0.0, 2.0], [-1.0, -2.0], [0.5, 1.0]])
    strip = as_strip("name", values, 10)
    read = np.frombuffer(base64.b64decode(strip["values"]), np.uint8).reshape(3, strip["units"])
    assert np.allclose((read - 128.0) / 127 * 2, values, atol=0.01)


def test_a_page_needs_nothing_from_elsewhere_and_is_small(page):
    addresses = set(re.findall(r"https?://[^\"' ]+", page))
    assert addresses <= {"http://www.w3.org/2000/svg"}  # a name, which nothing is loaded from
    assert not re.search(r"<link|src=\"|@import", page)
    assert len(page) < 2e6


def test_a_page_shows_a_success_a_failure_and_a_hidden_cube(page):
    episodes = content_of(page)["episodes"]
    assert [episode["hidden"] for episode in episodes] == [False, False, True]
    assert episodes[0]["outcome"] == "arrival" != episodes[1]["outcome"]
    for episode in episodes:
        T = len(episode["commands"])
        assert len(episode["poses"]) == T + 1
        assert len(episode["rewards"]) == len(episode["values"]) == T
        blue = (frames(episode["images"], T + 1) == (20, 20, 235)).all(-1).any()
        assert [strip["units"] for strip in episode["strips"]] == [32, 256, 256]
        assert not (blue and episode["hidden"])


def test_what_a_page_shows_is_what_the_policy_did_and_thought(page):
    """The same episode, driven again step by step by the network itself."""
    model, [scene, *_] = load_run("pretrained/env1.pt")
    episode = content_of(page)["episodes"][0]
    env = NavVecEnv(1, [scene], max_episode_steps=-1)
    env.reset(seed=0, options={"start": episode["poses"][0], "target": 0})
    env.goals[:] = episode["goal"]
    seen = env.observe(np.array([0]), env.world.poses, env.goals, np.zeros((1, 2)), np.zeros(1))
    memory = model.initial_state(1)
    strips = [np.frombuffer(base64.b64decode(strip["values"]), np.uint8).reshape(-1, strip["units"])
              for strip in episode["strips"]]
    features = []
    remembered = []
    for t, command in enumerate(episode["commands"][:12]):
        mean, _, _, value, memory = model.act(seen, memory, torch.Generator())
        assert value.item() / REWARD_SCALE == pytest.approx(episode["values"][t], abs=2)
        features.append(model.see(torch.as_tensor(seen["image"]))[0].detach().numpy())
        remembered.append(memory[0, :, 0].numpy().copy())
        action = np.array(command) / (MAX_LINEAR_VELOCITY, 1)
        assert np.allclose(mean[0].clip(torch.tensor((0.0, -1)), torch.tensor((1.0, 1))), action,
                           atol=0.05)
        seen, rewards, *_ = env.step(action[None])
        assert rewards[0] == pytest.approx(episode["rewards"][t], abs=0.1)
    for strip, values in zip(strips, (features, *np.swapaxes(remembered, 0, 1))):
        read = (strip[:12] - 128.0).ravel()
        assert np.corrcoef(read, np.ravel(values))[0, 1] > 0.98


def test_the_colours_of_a_page_are_those_of_the_boxes(page):
    scene = scenes.load("env1")
    shown = [box["colour"] for box in content_of(page)["boxes"]]
    assert shown == [PALETTE[box.material] for box in scene.boxes] and len(set(shown)) == 3


def test_a_noisy_room_stays_small_and_a_name_with_a_tag_is_text():
    rng = np.random.default_rng(0)
    noisy = rng.integers(0, 256, (201, H, W, 3), dtype=np.uint8) // 4 + 96
    url = as_sheet(noisy)
    assert url.startswith("data:image/jpeg") and len(url) < 6e5
    assert np.abs(frames(url, 201) - noisy.astype(float)).mean() < 25
    model, [scene, *_] = load_run("pretrained/env1.pt")
    page = make_page("<!--<script>", model, "mean", scene, "start", seed=0)
    assert "<!--<script" not in page and content_of(page)["title"] == "<!--<script>"


def test_the_shortest_way_leads_from_the_start_to_the_goal(page):
    episode = content_of(page)["episodes"][0]
    way = np.array(episode["shortest"])
    assert np.allclose(way[0], episode["poses"][0][:2], atol=1e-3)
    assert np.hypot(*(way[-1] - episode["goal"])) < 0.18


@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium")
def test_in_a_browser_play_moves_the_robot_and_scrubbing_shows_the_right_image(page, tmp_path):
    episode = content_of(page)["episodes"][0]
    T = len(episode["commands"])
    middle = T // 2
    file = tmp_path / "replay.html"
    file.write_text(page.replace("</body>", PLAYED.replace("STEP", str(middle)) + "</body>"))
    shown = subprocess.run([CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom",
                            "--virtual-time-budget=8000", file.as_uri()], capture_output=True,
                           text=True, timeout=300).stdout
    said = json.loads(re.search(r'<pre id="said">(.*?)</pre>', shown, re.DOTALL)[1]
                      .replace("&amp;", "&"))
    assert said["errors"] == []
    x, y, theta = episode["poses"][middle]
    numbers = [float(number) for number in re.findall(r"-?\d[\d.]*(?:e-?\d+)?", said["scrubbed"])]
    assert np.allclose(numbers, [x, -y, -np.degrees(theta)], atol=1e-3)
    seen = np.array(said["frame"]).reshape(H, W, 4)[..., :3]
    assert np.array_equal(seen, frames(episode["images"], T + 1)[middle])
    facts = dict(line.split("\t") for line in said["facts"].splitlines())
    rewards = np.array(episode["rewards"])
    assert float(facts["last reward"]) == pytest.approx(rewards[middle - 1], abs=0.06)
    assert float(facts["rewards so far"]) == pytest.approx(rewards[:middle].sum(), abs=0.06)
    assert float(facts["value"]) == pytest.approx(episode["values"][middle], abs=0.06)
    mirrored = [[x, -y] for x, y in episode["shortest"]]
    assert points_of(said["lines"][0]) == pytest.approx(np.array(mirrored))
    driven = [[x, -y] for x, y, _ in episode["poses"][:middle + 1]]
    assert points_of(said["lines"][1]) == pytest.approx(np.array(driven))
    assert said["steps"] == [middle - 1, middle, middle + 1] and said["left"] == middle
    assert said["clicked"] == pytest.approx(T / 4, abs=1)
    assert content_of(page)["episodes"][1]["outcome"] in said["second"]
    assert said["home"] == 0 and said["right"] == 1
    assert said["played"] > 3 and said["moved"] != said["scrubbed"]
    assert said["paused"] == said["still"] >= said["played"]
    assert said["last"].startswith("the title") and "hidden" in said["last"]


def test_the_command_line_writes_it_and_a_planner_has_none(tmp_path, monkeypatch, capsys):
    weights = tmp_path / "env1.pt"
    shutil.copy("pretrained/env1.pt", weights)
    monkeypatch.chdir(tmp_path)
    main([str(weights), "--episodes", "3", "--workers", "1", "--replay"])
    assert "watch it: " in capsys.readouterr().err
    page = (tmp_path / "evaluations" / "env1" / "replay.html").read_text()
    assert content_of(page)["title"] == "env1 in env1, protocol start"
    for words, said in ((["--planner", "bug"], "--replay needs a run"),
                        ([str(weights), "--hide", "place"], "--hide is place, with --replay")):
        with pytest.raises(SystemExit) as end:
            main([*words, "--replay"])
        assert end.value.code == 2
        assert said in capsys.readouterr().err


def test_random_rooms_have_a_replay_too():
    model, _ = load_run("pretrained/any-room.pt")
    page = make_page("any", model, "mean", scenes.load("random:3"), "anywhere", seed=1)
    assert len(content_of(page)["boxes"]) > 4
