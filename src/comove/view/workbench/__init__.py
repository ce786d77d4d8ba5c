"""The workbench in the browser: scenes and motions drawn in space, steered by hand, each motion verified anew."""
