"""Pictures of primitives, motions and executions."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.view.figures.measures import (
        Panel as Panel,
        draw_measures as draw_measures,
    )
    from comove.view.figures.motion import (
        draw_episodes as draw_episodes,
        draw_failures as draw_failures,
        draw_motion as draw_motion,
        draw_progress as draw_progress,
        draw_progress_side_by_side as draw_progress_side_by_side,
        draw_scene as draw_scene,
        draw_side_by_side as draw_side_by_side,
    )
    from comove.view.figures.notebooks import (
        as_html as as_html,
    )
    from comove.view.figures.pictures import (
        Joints as Joints,
        Pictures as Pictures,
    )
    from comove.view.figures.pipeline import (
        draw_pipeline as draw_pipeline,
    )
    from comove.view.figures.primitives import (
        draw_library as draw_library,
        draw_primitive as draw_primitive,
    )
    from comove.view.figures.results import (
        save_result as save_result,
    )
    from comove.view.figures.robots import (
        draw_joints as draw_joints,
        draw_robot as draw_robot,
    )
    from comove.view.figures.run import (
        animate_run as animate_run,
        draw_run as draw_run,
    )
    from comove.view.figures.style import (
        save as save,
        save_picture as save_picture,
    )

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "view.figures.measures": ["Panel", "draw_measures"],
        "view.figures.motion": [
            "draw_episodes",
            "draw_failures",
            "draw_motion",
            "draw_progress",
            "draw_progress_side_by_side",
            "draw_scene",
            "draw_side_by_side",
        ],
        "view.figures.notebooks": ["as_html"],
        "view.figures.pictures": ["Joints", "Pictures"],
        "view.figures.pipeline": ["draw_pipeline"],
        "view.figures.primitives": ["draw_library", "draw_primitive"],
        "view.figures.results": ["save_result"],
        "view.figures.robots": ["draw_joints", "draw_robot"],
        "view.figures.run": ["animate_run", "draw_run"],
        "view.figures.style": ["save", "save_picture"],
    },
)
