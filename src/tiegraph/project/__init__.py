"""The run folder: settings, receipts, resume, the pool, progress. Knows no photogrammetry.

**Receipts.** ``receipts/<stage>.json`` records what a stage did; ``receipts/files/<stage>.json`` lists each file it
made with size, time and a hash of its content. The key of a stage is a hash over its name and code version, its
settings (a file that they name counts with size and time), names, sizes and times of the inputs, and the keys of the
stages that it needs. A stage is up to date if it has the same key, if the files that it was made from are unchanged
(``from``, a hash over their contents), and if its own files match the list. After an interruption with the
same key the finished items stay: every file is written whole or not at all, and is on the disk before it has its
name; only missing ones are made. With another key the listed files are removed first. ``features`` and ``match``
share one SQLite database; ``match`` clears its own tables.

**Only our own files are touched** (``folder``, ``receipts``, ``artefacts``). A run folder is new, empty, or marked by a
run (``receipts/folder.json``). Inputs never lie where outputs go, and the run folder never lies among the images:
both are refused at the start. Before a file appears, its name goes to the journal ``receipts/made.txt``
(``scene.atomic``: ``replacing`` does this itself, files written by libraries are claimed), so that after a kill at any
moment it is known which files are ours. A file that is on no list is refused by name and never touched. A file that
was changed since is moved to ``set_aside/<time>/`` and made again; one that cannot be read is made again too
(``UnreadableArtefact``, raised by the readers of ``pipeline.files``; after any other error all contents are compared
with their hashes). Temporary files of processes that have ended are removed when the folder is opened. Settings are
stored when a run starts, and restored if they are refused before a stage was finished with them.

**Pool.** ``serial | local[:n] | dask:<address> | slurm:<jobs>``: one executor a run, in the main process, never
nested. A task is a chunk of items; workers get paths and settings and write files themselves. Workers and child
processes end with the process that started them, also after its SIGKILL. Ctrl-C, SIGTERM and SIGHUP end the run in one
line (``cli.main``), a second one at once. A process that is lost is an error, ``ProcessLost``, that names its signal.
With Dask (``daskpool``) the workers that exist at the start do the run, after each was checked (same versions;
run folder and images under the same paths). Each makes one item at a time, and its threads go to the libraries. A
lost worker ends the run with an error, and the next run continues it. Workers stop between two items when the run has
ended, and a run begins only when they are free. Cached files of a worker are keyed by the file's stamp
(``scene.atomic``). For SLURM (``pool.open_slurm``) the scheduler is in this process, and its workers are jobs.

**Stores** (``stores``). Inputs that are URLs are copied beside the run folder before the first stage; from there on
they are files. Only what has changed is copied, and nothing is ever removed or written over in a store.

Output of native libraries to standard error goes to the log (``libraries_to``).
"""
