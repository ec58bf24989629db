"""The robot in other physics engines than MuJoCo: a second opinion on a policy before a motor is switched on."""
