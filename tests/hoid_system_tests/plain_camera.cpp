// A camera driver in C++, as rclcpp would make it, without the transport profile of the suite.
//
//   plain_camera RELIABILITY DEPTH COUNT TOPIC
//
// It waits for a subscriber, publishes COUNT images of 640x480 pixels at 30 Hz, and ends. It uses rcl, since the wheels
// of ROS have no rclcpp.

#include <cstdlib>
#include <string>
#include <thread>

#include <rcl/rcl.h>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <sensor_msgs/msg/image.hpp>

namespace {

void check(rcl_ret_t status) {
  if (status != RCL_RET_OK) {
    std::exit(1);
  }
}

}  // namespace

int main(int argc, char ** argv) {
  using std::chrono::milliseconds;
  if (argc != 5) {
    return 2;
  }
  const std::string reliability = argv[1];
  rcl_init_options_t options = rcl_get_zero_initialized_init_options();
  check(rcl_init_options_init(&options, rcl_get_default_allocator()));
  rcl_context_t context = rcl_get_zero_initialized_context();
  check(rcl_init(0, nullptr, &options, &context));
  rcl_node_t node = rcl_get_zero_initialized_node();
  const rcl_node_options_t node_options = rcl_node_get_default_options();
  check(rcl_node_init(&node, "plain_camera", "", &context, &node_options));
  rcl_publisher_options_t publisher_options = rcl_publisher_get_default_options();
  publisher_options.qos.depth = std::strtoul(argv[2], nullptr, 10);
  publisher_options.qos.reliability = reliability == "reliable" ? RMW_QOS_POLICY_RELIABILITY_RELIABLE
                                                                : RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  const auto * type = rosidl_typesupport_cpp::get_message_type_support_handle<sensor_msgs::msg::Image>();
  check(rcl_publisher_init(&publisher, &node, type, argv[4], &publisher_options));
  for (size_t subscribers = 0; subscribers == 0;) {
    std::this_thread::sleep_for(milliseconds(50));
    check(rcl_publisher_get_subscription_count(&publisher, &subscribers));
  }
  std::this_thread::sleep_for(milliseconds(1000));  // the subscriber discovers the publisher later
  sensor_msgs::msg::Image image;
  image.width = 640;
  image.height = 480;
  image.encoding = "bgr8";
  image.step = 3 * image.width;
  image.header.frame_id = "camera";
  image.data.resize(image.step * image.height);
  const auto start = std::chrono::steady_clock::now();
  const int count = std::atoi(argv[3]);
  for (int i = 0; i < count; ++i) {
    std::this_thread::sleep_until(start + i * milliseconds(1000) / 30);
    image.header.stamp.sec = 1000 + i / 30;
    image.header.stamp.nanosec = (i % 30) * 33'333'333;
    check(rcl_publish(&publisher, &image, nullptr));
  }
  std::this_thread::sleep_for(milliseconds(2000));  // for reliable messages that are sent again
  check(rcl_publisher_fini(&publisher, &node));
  check(rcl_node_fini(&node));
  check(rcl_shutdown(&context));
  return 0;
}
