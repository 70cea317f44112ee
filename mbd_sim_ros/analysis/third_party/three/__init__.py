"""three.js 0.187.0: depth, perspective and light of what moves (docs/tools/three.py)."""
