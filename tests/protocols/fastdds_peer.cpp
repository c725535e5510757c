// A ROS 2 system without ROS, on eProsima's Fast DDS and Fast CDR, which ROS 2 uses by default: it publishes the readings
// of an IMU, joint angles and frames on 127.0.0.1. Arguments: number of the domain, seconds.
#include <fastcdr/Cdr.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include <chrono>
#include <cmath>
#include <functional>
#include <string>
#include <thread>
#include <vector>

using namespace eprosima::fastdds::dds;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;

using Fill = std::function<void(Cdr &)>;

class Filled : public TopicDataType {
 public:
  Filled(const std::string &name, bool big) : big_(big) {
    setName(name.c_str());
    m_typeSize = 4096;
    m_isGetKeyDefined = false;
  }
  bool serialize(void *data, SerializedPayload_t *payload) override {
    FastBuffer buffer(reinterpret_cast<char *>(payload->data), payload->max_size);
    Cdr cdr(buffer, big_ ? Cdr::BIG_ENDIANNESS : Cdr::LITTLE_ENDIANNESS, Cdr::DDS_CDR);
    payload->encapsulation = big_ ? CDR_BE : CDR_LE;
    cdr.serialize_encapsulation();
    (*static_cast<Fill *>(data))(cdr);
    payload->length = cdr.getSerializedDataLength();
    return true;
  }
  bool deserialize(SerializedPayload_t *, void *) override { return false; }
  std::function<uint32_t()> getSerializedSizeProvider(void *) override {
    return [] { return 4096u; };
  }
  void *createData() override { return new Fill; }
  void deleteData(void *data) override { delete static_cast<Fill *>(data); }
  bool getKey(void *, InstanceHandle_t *, bool) override { return false; }

 private:
  bool big_;
};

static void header(Cdr &cdr, int64_t stamp, const std::string &frame) {
  cdr << int32_t(stamp / 1000000000) << uint32_t(stamp % 1000000000) << frame;
}

static DataWriter *writer(DomainParticipant *participant, Publisher *publisher, const char *topic, const char *type,
                          bool reliable, bool big) {
  TypeSupport support(new Filled(type, big));
  support.register_type(participant);
  DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
  qos.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
  qos.publish_mode().kind = SYNCHRONOUS_PUBLISH_MODE;
  return publisher->create_datawriter(participant->create_topic(topic, type, TOPIC_QOS_DEFAULT), qos);
}

int main(int, char **arguments) {
  DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
  auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  transport->interfaceWhiteList.push_back("127.0.0.1");
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(transport);
  eprosima::fastrtps::rtps::Locator_t local;
  eprosima::fastrtps::rtps::IPLocator::setIPv4(local, 127, 0, 0, 1);
  qos.wire_protocol().builtin.initialPeersList.push_back(local);
  auto *participant = DomainParticipantFactory::get_instance()->create_participant(std::stoi(arguments[1]), qos);
  auto *publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
  auto *imu = writer(participant, publisher, "rt/imu/data_raw", "sensor_msgs::msg::dds_::Imu_", false, true);
  auto *joints = writer(participant, publisher, "rt/joint_states", "sensor_msgs::msg::dds_::JointState_", true, false);
  auto *frames = writer(participant, publisher, "rt/tf", "tf2_msgs::msg::dds_::TFMessage_", true, false);

  const auto began = std::chrono::steady_clock::now();
  for (int k = 0; k < 400 * std::stoi(arguments[2]); ++k) {
    const int64_t stamp = 1000000000 + int64_t(k) * 2500000;
    Fill reading = [=](Cdr &cdr) {
      header(cdr, stamp, "imu_link");
      const std::vector<double> none(9, 0.0);
      for (double v : {0.0, 0.0, 0.0, 1.0, -1.0}) cdr << v;
      for (int i = 0; i < 8; ++i) cdr << 0.0;
      cdr << 1e-3 * k << 0.25 << -0.5;
      for (double v : none) cdr << v;
      cdr << 0.0 << 1e-2 * k << 9.75;
      for (double v : none) cdr << v;
    };
    Fill angles = [=](Cdr &cdr) {
      header(cdr, stamp, "");
      cdr << std::vector<std::string>{"elbow_joint",         "shoulder_lift_joint", "shoulder_pan_joint",
                                      "wrist_1_joint", "wrist_2_joint",       "wrist_3_joint"};
      cdr << std::vector<double>{3.0, 2.0, 1e-4 * k, 4.0, 5.0, 6.0};
      cdr << std::vector<double>(6, 0.5) << std::vector<double>{};
    };
    Fill frame = [=](Cdr &cdr) {  // the tool, half a metre beyond a link that turns about z, and a frame of others
      cdr << uint32_t(3);
      header(cdr, stamp, "base_link");
      cdr << std::string("arm") << 0.0 << 0.0 << 1.0 << 0.0 << 0.0 << std::sin(5e-4 * k) << std::cos(5e-4 * k);
      header(cdr, stamp, "arm");
      cdr << std::string("tool0") << 0.5 << 0.0 << 0.0 << 0.0 << 0.0 << 0.0 << 1.0;
      header(cdr, stamp - 7, "map");
      cdr << std::string("cart") << 5.0 << 0.0 << 0.0 << 0.0 << 0.0 << 0.0 << 1.0;
    };
    imu->write(&reading);
    joints->write(&angles);
    frames->write(&frame);
    std::this_thread::sleep_until(began + std::chrono::microseconds(2500) * (k + 1));
  }
  return 0;
}
