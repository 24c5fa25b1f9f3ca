"""The colours of pictures and pages."""

# Colours of one picture differ for colour-blind readers too.
PALETTE = {
    "training": "#1f4fd8", "new": "#22b14c",  # targets, colours of Fig. 3
    "arrival": "#00708a", "collision": "#d7191c", "timeout": "#e6a800",  # outcomes
    "standing": "#7a4fb5",
    "one-start": "#b35806", "varied": "#542788",  # ways to train
    "run": "#9e0f66", "paper": "#9a9a9a",  # this run, the paper's released records
    "wall": "#d3ccc4", "brick": "#bd7f73", "wood": "#e6c08f",  # boxes, paler than in the camera
    "robot": "#222222", "goal": "#6b6b6b",  # a random target
    "cube": "#1414eb",  # every target in the camera image
    "input": "#fbe9c9", "layer": "#e3e8ee", "memory": "#f3d9e3", "output": "#d8ebe6"}  # diagrams
