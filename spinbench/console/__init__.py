"""The bench console: a run watched, started and stopped, as a page in the browser or in the terminal.

It is a process of its own that only reads the run's folder. A sweep is another process; neither ends the other.

words        what a state means, what it waits for, what to do about an alarm
facts        everything that is shown of a run, as plain data for the page and the terminal
stopping     STOP: asked of the process that writes a run, and whether its log says that it was done
planned      one run that is to be taken, and a table of them
recommended  tests that diagnoses recommend
sweeps       the process of a run that a console starts
entries      what a run by hand asks, and readings typed in the page
queue        runs that are planned one after the other
access       who may ask for what: hosts, origins, tokens, files
desk         what all windows share: the run, who controls, what was acknowledged
server       the page and its events
live         the same facts for others, read only
mqtt, opcua  the two ways by which they come
terminal     the same facts in the terminal
"""
