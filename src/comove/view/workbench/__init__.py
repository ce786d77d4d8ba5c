"""Interactive workbench in the browser. Scenes and motions are drawn in space and edited by hand; each motion is
verified again."""
