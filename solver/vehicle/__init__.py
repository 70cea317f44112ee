"""Vehicle templates: functions from hardpoints and data to model specs. The data are in config/vehicles."""
