"""View: a page in the browser, to look at a dataset, and to press a sensor by hand.

Modules without NiceGUI prepare what the page shows: surfaces, colours, words, and presses on worker processes. The
page's own modules draw it. NiceGUI serves it, because it keeps a state for each client, reads links and keys, and has
three.js and plotly.js in its wheel.
"""
