"""The live view: a page in the browser that shows a run that goes on, or a bag, and only looks at it."""
