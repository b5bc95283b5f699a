"""Compare the five paradigms on one material: compare_paradigms.py MATERIAL.binary

All paradigms fit equal networks (recipe quick). Overfit takes 2,000 of its 20,000 steps, so that the
script ends within seconds.
"""

import sys

import metapp

material = sys.argv[1]
print("paradigm   error x100   seconds")
for paradigm in ("general", "quickft", "meta", "finetune", "overfit"):
    steps = 2000 if paradigm == "overfit" else None
    fit = metapp.fit("brdf", material, paradigm=paradigm, steps=steps, recipe="quick")
    print(f"{paradigm:<9}  {fit.error:10.3f}   {fit.seconds:7.3f}")
