"""Viewing recordings in 3D with viser. Scenes are live in the browser, or one page."""
