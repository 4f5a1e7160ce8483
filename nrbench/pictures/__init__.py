"""Pictures as people have them: files and folders, the truth beside them, and sheets on which they are shown."""
