
<?xml version="1.0"?>
<robot name="pole">
  <link name="pole">
    <inertial>
      <mass value="1"/>
      <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"/>
    </inertial>
    <collision>
      <geometry><cylinder radius="0.1" length="1"/></geometry>
    </collision>
  </link>
</robot>
