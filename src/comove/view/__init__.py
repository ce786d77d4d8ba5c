"""What people look at: figures, notebooks and the workbench in the browser."""
