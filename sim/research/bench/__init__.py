"""`make bench`: what each stage costs, beside other implementations and the least that this machine can take.

machine  memory bandwidth and int8 rate
*_rows   the measurements, stage by stage
rows     the page in Markdown
"""

import sim.bench  # noqa: F401  one thread, before faiss loads its library
