// Publishes one lap, latched.
#include <course_base/Lap.h>
#include <course_base/SpeedConfig.h>
#include <course_base/WaitAction.h>
#include <gazebo_msgs/SetModelState.h>
#include <ros/ros.h>

int main(int argc, char **argv) {
  ros::init(argc, argv, "lap_node");
  ros::NodeHandle node;
  ros::Publisher publisher = node.advertise<course_base::Lap>("lap", 1, true);
  gazebo_msgs::SetModelState call;
  course_base::WaitGoal goal;
  goal.seconds = course_base::SpeedConfig::__getDefault__().speed;
  course_base::Lap lap;
  lap.number = 1 + static_cast<int>(call.request.model_state.model_name.size());
  lap.seconds = goal.seconds;
  publisher.publish(lap);
  ros::spin();
}
