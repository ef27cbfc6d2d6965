// Answers the service "scale".
#include <course_base/Scale.h>
#include <ros/ros.h>

bool scale(course_base::Scale::Request &request, course_base::Scale::Response &response) {
  response.scaled = 10.0 * request.number;
  return true;
}

int main(int argc, char **argv) {
  ros::init(argc, argv, "scale_node");
  ros::NodeHandle node;
  ros::ServiceServer server = node.advertiseService("scale", scale);
  ros::spin();
}
