// Simulates the world of an SDF file in Gazebo's physics library (ignition-physics) for another program, step by step.
//
//     gazebo PLUGIN WORLD.sdf TIMESTEP FREE JOINTS [JOINT ...] [LINK ...]
//
// PLUGIN is the engine's shared library, TIMESTEP is in seconds, FREE is 1 for a robot whose first link moves freely, and
// JOINTS is the number of names of joints, behind which come the names of links whose contacts are told. The world has
// the models "ground" and "robot". Numbers are doubles of the machine. Standard input has a letter and its numbers:
//
//     p  angles and velocities of the joints, and of a free robot its base: put the robot there
//     s  a torque or force for each joint: take a step
//
// A base is its origin (3), its rotation matrix by rows (9), its velocity (3) and its angular velocity (3), all in the
// world. The answer to each, and to the start, is the angles, the velocities, the base of a free robot, and for each link
// 1 if it touches the ground, else 0. The program ends with its input; what went wrong is said on standard error.

#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <map>
#include <stdexcept>
#include <string>
#include <sys/socket.h>
#include <unistd.h>
#include <vector>

#include <ignition/physics/ForwardStep.hh>
#include <ignition/physics/FrameSemantics.hh>
#include <ignition/physics/FreeGroup.hh>
#include <ignition/physics/GetContacts.hh>
#include <ignition/physics/GetEntities.hh>
#include <ignition/physics/Joint.hh>
#include <ignition/physics/RequestEngine.hh>
#include <ignition/physics/sdf/ConstructWorld.hh>
#include <ignition/plugin/Loader.hh>
#include <sdf/Root.hh>
#include <sdf/World.hh>

namespace physics = ignition::physics;

// The library's profiler would wait for visitors on a port of all network addresses: it finds this bind, and gets none.
extern "C" int bind(int, const sockaddr*, socklen_t) noexcept {
  errno = EACCES;
  return -1;
}

struct Features : physics::FeatureList<
                      physics::ForwardStep, physics::GetContactsFromLastStepFeature, physics::GetEntities,
                      physics::GetBasicJointState, physics::SetBasicJointState, physics::LinkFrameSemantics,
                      physics::FindFreeGroupFeature, physics::SetFreeGroupWorldPose, physics::SetFreeGroupWorldVelocity,
                      physics::sdf::ConstructSdfWorld> {};

using Joint = physics::Joint3dPtr<Features>;
using Link = physics::Link3dPtr<Features>;

// A robot in its world.
class Simulation {
 public:
  Simulation(const std::string& plugin, const std::string& file, double timestep, bool free,
             const std::vector<std::string>& joints, const std::vector<std::string>& links)
      : free_(free) {
    const auto step = std::chrono::duration<double>(timestep);
    input_.Get<std::chrono::steady_clock::duration>() =
        std::chrono::round<std::chrono::steady_clock::duration>(step);
    const auto errors = root_.Load(file);
    if (!errors.empty()) throw std::runtime_error(errors.front().Message());
    if (root_.WorldCount() != 1) throw std::runtime_error("the file has not one world");
    loader_.LoadLib(plugin);
    const auto wanted = loader_.Instantiate("ignition::physics::dartsim::Plugin");
    const auto engine = physics::RequestEngine3d<Features>::From(wanted);
    if (!engine) throw std::runtime_error("the engine of " + plugin + " cannot be loaded or lacks features");
    world_ = engine->ConstructWorld(*root_.WorldByIndex(0));
    const auto robot = world_ ? world_->GetModel("robot") : nullptr;
    if (!robot) throw std::runtime_error("the engine has made no model 'robot' of the file");
    for (const auto& name : joints) {
      joints_.push_back(robot->GetJoint(name));
      if (!joints_.back()) throw std::runtime_error("the engine has made no joint '" + name + "'");
    }
    for (const auto& name : links) {
      const auto link = robot->GetLink(name);
      if (!link) throw std::runtime_error("the engine has made no link '" + name + "'");
      for (std::size_t i = 0; i < link->GetShapeCount(); ++i)
        shapes_[link->GetShape(i)->EntityID()] = touching_.size();
      touching_.push_back(0.0);
    }
    if (free) {
      group_ = robot->FindFreeGroup();
      if (!group_) throw std::runtime_error("the engine lets the base of the robot not move freely");
      base_ = group_->RootLink();
    }
  }

  std::size_t joints() const { return joints_.size(); }

  std::size_t base() const { return free_ ? 18 : 0; }

  void put(const double* numbers) {
    // The library turns velocities with the pose that it had: from the same pose it comes to the same bits.
    std::vector<double> rest(2 * joints_.size() + base(), 0.0);
    if (free_)
      for (std::size_t i = 0; i < 3; ++i) rest[2 * joints_.size() + 3 + 4 * i] = 1.0;
    move(rest.data());
    move(numbers);
    // Its contacts are those of the last step, which was elsewhere.
    touching_.assign(touching_.size(), 0.0);
  }

  void step(const double* forces) {
    for (std::size_t i = 0; i < joints_.size(); ++i) joints_[i]->SetForce(0, forces[i]);
    world_->Step(output_, state_, input_);
    touching_.assign(touching_.size(), 0.0);
    for (const auto& contact : world_->GetContactsFromLastStep()) {
      const auto& point = contact.Get<Contact::ContactPoint>();
      const auto one = shapes_.find(point.collision1->EntityID()), other = shapes_.find(point.collision2->EntityID());
      if (one != shapes_.end() && other == shapes_.end()) touching_[one->second] = 1.0;
      if (other != shapes_.end() && one == shapes_.end()) touching_[other->second] = 1.0;
    }
  }

  std::vector<double> state() const {
    std::vector<double> numbers;
    for (const auto& joint : joints_) numbers.push_back(joint->GetPosition(0));
    for (const auto& joint : joints_) numbers.push_back(joint->GetVelocity(0));
    if (free_) {
      const auto frame = base_->FrameDataRelativeToWorld();
      const Matrix turn = frame.pose.linear();
      const Eigen::Vector3d at = frame.pose.translation();
      numbers.insert(numbers.end(), at.data(), at.data() + 3);
      numbers.insert(numbers.end(), turn.data(), turn.data() + 9);
      numbers.insert(numbers.end(), frame.linearVelocity.data(), frame.linearVelocity.data() + 3);
      numbers.insert(numbers.end(), frame.angularVelocity.data(), frame.angularVelocity.data() + 3);
    }
    numbers.insert(numbers.end(), touching_.begin(), touching_.end());
    return numbers;
  }

 private:
  using Contact = physics::World3d<Features>;
  using Matrix = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

  void move(const double* numbers) {
    const std::size_t count = joints_.size();
    for (std::size_t i = 0; i < count; ++i) {
      joints_[i]->SetPosition(0, numbers[i]);
      joints_[i]->SetVelocity(0, numbers[count + i]);
    }
    if (!free_) return;
    const double* base = numbers + 2 * count;
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translation() = Eigen::Map<const Eigen::Vector3d>(base);
    pose.linear() = Eigen::Map<const Matrix>(base + 3);
    group_->SetWorldPose(pose);
    group_->SetWorldLinearVelocity(Eigen::Map<const Eigen::Vector3d>(base + 12));
    group_->SetWorldAngularVelocity(Eigen::Map<const Eigen::Vector3d>(base + 15));
  }

  bool free_;
  sdf::Root root_;
  ignition::plugin::Loader loader_;
  physics::World3dPtr<Features> world_;
  std::vector<Joint> joints_;
  std::map<std::size_t, std::size_t> shapes_;
  std::vector<double> touching_;
  physics::FreeGroup3dPtr<Features> group_;
  Link base_;
  physics::ForwardStep::Input input_;
  physics::ForwardStep::Output output_;
  physics::ForwardStep::State state_;
};

// Answers until the input ends.
static int serve(Simulation& simulation, std::FILE* answers) {
  const std::size_t joints = simulation.joints();
  std::vector<double> numbers(2 * joints + simulation.base());
  for (;;) {
    const auto state = simulation.state();
    if (std::fwrite(state.data(), sizeof(double), state.size(), answers) != state.size()) return 1;
    if (std::fflush(answers) != 0) return 1;
    const int letter = std::getchar();
    if (letter == EOF) return 0;
    const std::size_t count = letter == 'p' ? numbers.size() : joints;
    if (std::fread(numbers.data(), sizeof(double), count, stdin) != count) return 0;
    letter == 'p' ? simulation.put(numbers.data()) : simulation.step(numbers.data());
  }
}

int main(int count, char** arguments) {
  // Ctrl-C goes to all processes of a terminal; this one ends with its input.
  std::signal(SIGINT, SIG_IGN);
  // The library prints, too.
  std::FILE* answers = fdopen(dup(STDOUT_FILENO), "wb");
  dup2(STDERR_FILENO, STDOUT_FILENO);
  try {
    const std::vector<std::string> words(arguments + 1, arguments + count);
    const auto joints = words.begin() + 5, links = joints + std::stol(words.at(4));
    Simulation simulation(words[0], words[1], std::stod(words[2]), words[3] == "1", {joints, links}, {links, words.end()});
    return serve(simulation, answers);
  } catch (const std::exception& error) {
    std::cerr << error.what() << std::endl;
    return 1;
  }
}
