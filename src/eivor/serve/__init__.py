"""A page on one's own machine: a server of the loopback address only, and its worker processes.

What the page and the server say to each other. Every request but the first has the header ``X-Eivor-Token``.
Answers are JSON unless said otherwise; every error is
``{"error": {"expected", "received", "advice", "sentence"}}``.

``GET /?token=T``
    The page.
``GET /choices``
    ``models``, ``methods``, ``maps``, ``vehicles``, ``targets``, ``plans``: each a list of
    ``{"name", "words"}``, the last two with ``file``, plans with ``needs``; ``largest_bytes``; and
    ``folders``, by which names files of a folder are told to be logs, or one log together.
``POST /logs``
    The bytes of a log, with its name, percent-encoded, in ``X-Eivor-Name``: ``{"log", "name", "bytes"}``.
    A folder's files are sent one after the other, with ``NAME/BYTES`` of each in ``X-Eivor-Files``.
``POST /example``
    The same of the flight that comes with Eivor.
``DELETE /logs/LOG``
    ``{}``
``POST /jobs``
    ``{"logs": [LOG or {"log": LOG, "window": [FROM, TO]}], "options": {}}``: ``{"job"}``.
``GET /jobs/JOB/events``
    A line of JSON for everything that happens, and one each second: ``{"stage", "elapsed"}``, where it waits
    with ``position``; the last is ``{"done": {"status"}}``, ``{"failed": ERROR}`` or ``{"cancelled": true}``.
``DELETE /jobs/JOB``
    ``{}``: cancelled, or when it is over forgotten.
``GET /jobs/JOB/result.json``
    What ``eivor identify --json`` writes.
``GET /jobs/JOB/report.html``
    What ``eivor report`` writes; the answer waits until it is there.
``GET /jobs/JOB/exports?mass=&prior=&vehicle=``
    ``{"targets": [{"name", "words", "file", "reason", "left_out"}]}``; an empty reason says ready.
``GET /jobs/JOB/exports/TARGET?mass=&prior=&vehicle=``
    The file.
``GET /jobs/JOB/plan/FORMAT?home=&for=``
    The file.

Options of a job are words as on the command line: ``model``, ``vehicle`` (the name of a shipped one, or the
text of a vehicle's file), ``map`` (likewise), ``mass`` (of exports), ``window`` (also as two numbers), and
every option of `eivor.asked.options.flight_options` by its name there but `lag_from`, which is a path.
"""
