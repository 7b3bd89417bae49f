"""Arms as MJCF text, as users have them: with motors, hands and keyframes of their own, in degrees, on a floor."""

SIX = """
<mujoco model="six">
  <compiler angle="degree" autolimits="true"/>
  <default>
    <geom type="capsule" size="0.05"/>
    <joint axis="0 1 0" range="-360 360" damping="200"/>
    <default class="look"><geom contype="0" conaffinity="0" group="2" mass="0.3"/></default>
    <default class="touch"><geom group="3"/></default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1"/>
    <body name="block" pos="1 1 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
    <body name="base" pos="0.3 0.2 0.05" quat="1 0 0 1">
      <geom class="touch" fromto="0 0 0 0 0 0.08" size="0.06"/>
      <body name="shoulder" pos="0 0 0.16">
        <joint name="pan" axis="0 0 1"/>
        <geom class="touch" fromto="0 0 -0.04 0 0 0.02"/>
        <geom class="look" fromto="0 0 -0.04 0 0 0.02" size="0.07"/>
        <body name="upper" pos="0 0.13 0" quat="1 0 1 0">
          <joint name="lift"/>
          <geom class="touch" fromto="0 0 0 0 0 0.42"/>
          <body name="fore" pos="0 -0.13 0.42">
            <joint name="elbow" range="-180 180"/>
            <geom class="look" fromto="0 0 0 0 0 0.39" size="0.04"/>
            <body name="wrist_a" pos="0 0 0.39" quat="1 0 1 0">
              <joint name="roll" ref="10"/>
              <geom class="touch" fromto="0 0 0 0 0.12 0" size="0.04"/>
              <body name="wrist_b" pos="0 0.12 0">
                <joint name="pitch" axis="0 0 1"/>
                <geom class="touch" fromto="0 0 0 0 0 0.1" size="0.04"/>
                <body name="wrist_c" pos="0 0 0.1">
                  <joint name="yaw"/>
                  <geom class="touch" fromto="0 0.02 0 0 0.04 0" size="0.035"/>
                  <site name="attachment_site" pos="0 0.08 0" quat="-1 1 0 0"/>
                  <body name="claw" pos="0 0.08 0">
                    <geom class="touch" fromto="0 0 0 0 0.05 0" size="0.02"/>
                    <body name="left">
                      <joint name="left" type="slide" range="0 0.04"/>
                      <geom type="box" size="0.01 0.01 0.05"/>
                    </body>
                    <body name="right">
                      <joint name="right" type="slide" range="0 0.04"/>
                      <geom type="box" size="0.01 0.01 0.05"/>
                    </body>
                  </body>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="left" joint2="right"/></equality>
  <tendon><fixed name="both"><joint joint="left" coef="1"/><joint joint="right" coef="1"/></fixed></tendon>
  <actuator><motor name="pan" joint="pan"/><position name="grip" tendon="both" kp="10"/></actuator>
  <sensor><jointpos joint="elbow"/></sensor>
  <keyframe><key name="home" qpos="0 0 0 1 0 0 0  0 0 0 0 0 0  0 0"/></keyframe>
</mujoco>
"""

_SEVEN_LINKS = (
    ("0 0 0.34", "0 0 1", "-170 170"),
    ("0 0 0", "0 1 0", "-120 120"),
    ("0 0 0.40", "0 0 1", "-170 170"),
    ("0 0 0", "0 -1 0", "-120 120"),
    ("0 0 0.40", "0 0 1", "-170 170"),
    ("0 0 0", "0 1 0", "-120 120"),
    ("0 0 0.126", "0 0 1", "-175 175"),
)


def seven(links=_SEVEN_LINKS, hull="hull.obj", joint='type="hinge"'):
    """An arm whose links are meshes, and whose last body's frame is where a hand is mounted."""
    opened = "".join(
        f'<body name="link{number}" pos="{place}"><joint name="j{number}" axis="{axis}" range="{limits}" {joint}/>'
        '<geom type="mesh" mesh="hull"/>'
        for number, (place, axis, limits) in enumerate(links, start=1)
    )
    return (
        '<mujoco><compiler autolimits="true" meshdir="shapes"/>'
        f'<asset><mesh name="hull" file="{hull}" scale="0.05 0.05 0.05"/></asset>'
        f'<worldbody><body name="stand"><geom type="mesh" mesh="hull"/>{opened}'
        f"{'</body>' * len(links)}</body></worldbody></mujoco>"
    )


HULL = """\
v 1 1 1
v 1 -1 -1
v -1 1 -1
v -1 -1 1
f 1 2 3
f 1 4 2
f 1 3 4
f 2 4 3
"""
