"""The live view: a page in the browser that shows a simulation as it runs."""
