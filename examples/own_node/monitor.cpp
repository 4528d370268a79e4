// A node of your own in C++: it monitors a swarm, and requests a stop when the plane tilts too far.

#include <cmath>
#include <memory>

#include <rclcpp/rclcpp.hpp>
#include <std_srvs/srv/trigger.hpp>
#include <swarmabs_msgs/msg/abstract_state.hpp>
#include <swarmabs_msgs/msg/plane_state.hpp>
#include <swarmabs_msgs/msg/swarm_event.hpp>

using std_srvs::srv::Trigger;
using swarmabs_msgs::msg::AbstractState;
using swarmabs_msgs::msg::PlaneState;
using swarmabs_msgs::msg::SwarmEvent;

class Monitor : public rclcpp::Node
{
public:
  Monitor()
  : Node("monitor"), limit_(declare_parameter("angle_limit", 0.0))
  {
    const auto states = rclcpp::QoS(10).best_effort();
    const auto events = rclcpp::QoS(1000).transient_local();
    stop_ = create_client<Trigger>("swarm/stop");
    plane_ = create_subscription<PlaneState>(
      "plane/state", states, [this](const PlaneState & plane) {hear(plane);});
    swarm_ = create_subscription<AbstractState>(
      "swarm/abstract_state", states, [this](const AbstractState & swarm) {torque_ = swarm.torque;});
    events_ = create_subscription<SwarmEvent>(
      "swarm/events", events, [this](const SwarmEvent & event) {
        RCLCPP_INFO(
          get_logger(), "step %zu: event %d of robot %d: %s", static_cast<size_t>(event.step), event.kind,
          event.agent_id, event.detail.c_str());
      });
  }

private:
  void hear(const PlaneState & plane)
  {
    RCLCPP_INFO_THROTTLE(
      get_logger(), *get_clock(), 1000, "step %zu: %+.4f rad, %+.3f N m", static_cast<size_t>(plane.step),
      plane.angle, torque_);
    if (limit_ > 0.0 && std::abs(plane.angle) > limit_ && !asked_ && stop_->service_is_ready()) {
      asked_ = true;
      RCLCPP_INFO(
        get_logger(), "step %zu: %.4f rad is beyond %g rad: stop requested", static_cast<size_t>(plane.step),
        plane.angle, limit_);
      stop_->async_send_request(
        std::make_shared<Trigger::Request>(), [this](rclcpp::Client<Trigger>::SharedFuture answer) {
          const auto result = answer.get();
          RCLCPP_INFO(
            get_logger(), "stop %s: %s", result->success ? "accepted" : "rejected", result->message.c_str());
        });
    }
  }

  double limit_;        // rad; 0: never request a stop
  double torque_{0.0};  // N m
  bool asked_{false};
  rclcpp::Client<Trigger>::SharedPtr stop_;
  rclcpp::Subscription<PlaneState>::SharedPtr plane_;
  rclcpp::Subscription<AbstractState>::SharedPtr swarm_;
  rclcpp::Subscription<SwarmEvent>::SharedPtr events_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<Monitor>());
  rclcpp::shutdown();
  return 0;
}
